"""Blobs: one round 3D Gaussian at each point of the scene, which Adam moves, colors and fades."""

from dataclasses import dataclass

import torch

from envgs_bench.core import GaussianSet, rasterize
from envgs_bench.methods.method import Method


@dataclass(frozen=True)
class BlobsSettings:
    size: float = 0.02  # standard deviation, × scene radius
    learning_rate: float = 1e-2


class Blobs(Method):
    Settings = BlobsSettings

    def initialize(self, scene, steps):
        n = len(scene.points)
        sh = (scene.point_colors[:, None] - 0.5) / 0.28209479  # by the constant spherical harmonic
        self._start_from([scene.points, sh, torch.zeros(n), torch.full((n, 3), self.settings.size * scene.radius)])

    def _start_from(self, tensors):
        *trained, self.scales = (tensor.to(self.device).clone() for tensor in tensors)
        self.trained = [tensor.requires_grad_() for tensor in trained]
        self.optimizer = torch.optim.Adam(self.trained, lr=self.settings.learning_rate)

    def _draw(self, camera):
        means, sh, opacity_logits = self.trained
        upright = torch.tensor([1.0, 0, 0, 0], device=self.device).expand(len(means), 4)
        return rasterize(GaussianSet(means, upright, self.scales, opacity_logits.sigmoid(), sh), camera)

    def training_step(self, view, step):
        picture = self._draw(view.camera.to(self.device)).color
        loss = (picture - view.rgb(self.device)).square().mean()
        self.optimizer.zero_grad()
        loss.backward()
        if all(tensor.grad.isfinite().all() for tensor in self.trained):
            self.optimizer.step()
        else:
            self.skipped_steps += 1
        return {"loss": loss.detach(), "psnr": -10 * loss.detach().log10()}

    @torch.no_grad()
    def render(self, camera):
        return self._draw(camera.to(self.device))

    def primitives(self):
        return {"base": len(self.scales), "env": 0}

    def model_bytes(self):
        return {"base": 4 * sum(tensor.numel() for tensor in [*self.trained, self.scales]), "env": 0}

    def save(self, folder):
        folder.mkdir(parents=True, exist_ok=True)
        torch.save([tensor.detach() for tensor in [*self.trained, self.scales]], folder / "blobs.pt")

    def load(self, folder):
        self._start_from(torch.load(folder / "blobs.pt", map_location=self.device))
