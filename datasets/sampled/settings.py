"""SampledSettings: which of the distribution's scenes, and how it is drawn."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from ..settings import Edge, SourceSettings, not_too_tall


class SampledSettings(SourceSettings):
    """Settings of `kind: sampled`."""

    kind: Literal["sampled"]
    seed: Annotated[int, Field(ge=0)] = 0  # which scene
    width: Edge = 400  # pixels
    height: Annotated[Edge, Field(validate_default=True), AfterValidator(not_too_tall)] = 300
    views: Annotated[int, Field(ge=8)] = 60  # training and test views together; where few were taken, a share of them
    unseen: Annotated[int, Field(ge=0)] = 0  # views between the training cameras, and as many beyond them
    tracer: Literal["cpu", "gpu"] = "cpu"  # where pictures are traced; but for noise they are the same
    supersampling: Annotated[int, Field(ge=1)] = 4  # its square are the paths a pixel; four times as many test
