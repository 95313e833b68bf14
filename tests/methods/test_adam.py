"""Adam's memory: there before a GPU's first step, and as it was after an interruption."""

import pytest
import torch

from envgs_bench.methods.training.optimizer import KernelAdam, adam, optimizer_state, restore_optimizer


def begun() -> tuple[dict[str, torch.Tensor], KernelAdam]:
    parameters = {"moved": torch.ones(3, requires_grad=True), "still": torch.ones(2, 2, requires_grad=True)}
    groups = [{"params": [values], "lr": torch.full((), 0.1), "name": name} for name, values in parameters.items()]
    return parameters, KernelAdam(groups, eps=1e-15, capturable=True)


def test_what_a_gpu_remembers_is_there_before_the_first_step():
    """What a recording makes, each of its replays makes anew: with the texels of a map that grew, Adam forgot all."""
    parameters, optimizer = begun()
    for values in parameters.values():
        state = optimizer.state[values]
        assert set(state) == {"step", "exp_avg", "exp_avg_sq"}
        assert float(state["step"]) == 0
        assert all(not state[name].any() and state[name].shape == values.shape for name in ("exp_avg", "exp_avg_sq"))


def test_a_memory_is_restored_and_one_of_nothing_too():
    parameters, optimizer = begun()
    optimizer.state[parameters["moved"]] = {
        "step": torch.tensor(4.0), "exp_avg": torch.full((3,), 0.5), "exp_avg_sq": torch.full((3,), 0.25)
    }  # fmt: skip
    known = optimizer_state(optimizer, parameters)
    again, other = begun()
    restore_optimizer(other, again, {"moved": known["moved"], "still": {"lr": 0.2}})
    assert float(other.state[again["moved"]]["step"]) == 4
    torch.testing.assert_close(other.state[again["moved"]]["exp_avg"], torch.full((3,), 0.5))
    assert float(other.state[again["still"]]["step"]) == 0
    assert float(other.param_groups[1]["lr"]) == pytest.approx(0.2)


def test_on_a_cpu_a_parameter_that_has_not_moved_is_forgotten():
    values = torch.ones(3, requires_grad=True)
    optimizer = adam([{"params": [values], "lr": 0.1, "name": "values"}])
    values.grad = torch.ones(3)
    optimizer.step()
    restore_optimizer(optimizer, {"values": values}, {"values": {"lr": 0.1}})
    assert not optimizer.state.get(values)
