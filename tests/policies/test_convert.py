"""TorchScript becomes ONNX with its state outside; needs PyTorch (extra `models`)."""

import sys

import numpy as np
import onnx
import pytest

from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.torchscript import load
from downbeat.policies.manifest import load_skills
from downbeat.tools.cli import main

needs_torch = pytest.mark.filterwarnings("ignore")


def recurrent(torch, kind, layers=1, replaces=False):
    """A policy of 47 observations and 12 actions that hides its state, as exporters write it."""

    class Policy(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.rnn = getattr(torch.nn, kind)(47, 16, layers)
            self.actor = torch.nn.Sequential(torch.nn.Linear(16, 12), torch.nn.ELU())
            self.register_buffer("hidden_state", torch.zeros(layers, 1, 16))
            self.register_buffer("cell_state", torch.zeros(layers, 1, 16))

    class Lstm(Policy):
        def forward(self, x):
            x, (h, c) = self.rnn(x.unsqueeze(0), (self.hidden_state, self.cell_state))
            self.hidden_state[:] = h
            self.cell_state[:] = c
            return self.actor(x.squeeze(0))

    class Replacing(Policy):
        def forward(self, x):
            x, (h, c) = self.rnn(x.unsqueeze(0), (self.hidden_state, self.cell_state))
            self.hidden_state = h
            self.cell_state = c
            return self.actor(x.squeeze(0))

    class Gru(Policy):
        def forward(self, x):
            x, h = self.rnn(x.unsqueeze(0), self.hidden_state)
            self.hidden_state[:] = h
            return self.actor(x.squeeze(0))

    torch.manual_seed(0)
    return {"GRU": Gru, "LSTM": Replacing if replaces else Lstm}[kind]().eval()


def save(torch, module, path):
    torch.jit.script(module).save(str(path))
    return path


@pytest.fixture
def torch():
    return pytest.importorskip("torch", reason="no PyTorch (extra `models`)")


@pytest.mark.slow
@needs_torch
@pytest.mark.parametrize(
    ("kind", "layers", "replaces", "states"),
    [
        ("LSTM", 1, False, {"h_in", "c_in"}),
        ("LSTM", 2, False, {"h_in", "c_in"}),
        ("LSTM", 1, True, {"h_in", "c_in"}),
        ("GRU", 2, False, {"h_in"}),
    ],
)
def test_hidden_state_becomes_input_and_output(
    torch, tmp_path, capsys, kind, layers, replaces, states
):
    path = save(torch, recurrent(torch, kind, layers, replaces), tmp_path / "policy.pt")
    out = tmp_path / "walker.onnx"
    assert main(["policy", "convert", str(path), "--out", str(out)]) == 0
    model = onnx.load(str(out))
    assert {v.name for v in model.graph.input} == {"obs", *states}
    printed = capsys.readouterr().out
    assert float(printed.split("random steps: ")[1].split()[0]) <= 1e-5
    assert main(["policy", "import", str(out), "--out", str(tmp_path / "skills"), "--json"]) == 0
    (manifest,) = load_skills(tmp_path / "skills").values()
    assert {r.input for r in manifest.policy.recurrent} == states


@pytest.mark.slow
@needs_torch
def test_normalisers_convolutions_and_histories_are_converted(torch, tmp_path):
    class Policy(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.norm = torch.nn.LayerNorm(20)
            self.linear = torch.nn.Linear(20, 8)
            self.batch = torch.nn.BatchNorm1d(8)
            self.conv = torch.nn.Conv1d(2, 3, 3)

        def forward(self, x):
            y = torch.nn.functional.silu(self.batch(self.linear(self.norm(x))))
            z = y * torch.softmax(y, -1) + y.mean(1, keepdim=True) ** 2
            w = self.conv(z.view(1, 2, 4)).flatten(1)
            return torch.cat([w.clamp(-1.0, 1.0), z[:, ::2], x[:, -3:]], -1)

    path = save(torch, Policy().eval(), tmp_path / "policy.pt")
    assert main(["policy", "convert", str(path), "--out", str(tmp_path / "a.onnx")]) == 0


@pytest.mark.slow
@needs_torch
def test_branches_on_the_observation_are_refused(torch, tmp_path, capsys):
    class Policy(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.linear = torch.nn.Linear(5, 3)

        def forward(self, x):
            if bool(x.sum() > 0.0):
                return self.linear(x)
            return -self.linear(x)

    path = save(torch, Policy().eval(), tmp_path / "policy.pt")
    out = tmp_path / "a.onnx"
    assert main(["policy", "convert", str(path), "--out", str(out)]) == 2
    assert "uses the operation 'gt', which is not supported" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.slow
@needs_torch
def test_a_pickled_checkpoint_is_never_opened(torch, tmp_path):
    path = tmp_path / "model.pt"
    torch.save({"weights": np.zeros(3)}, path)
    with pytest.raises(PolicyError, match="not a TorchScript file.*torch.jit.script"):
        load(path)


def test_without_pytorch_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(PolicyError, match="needs PyTorch.*extra `models`"):
        load(tmp_path / "policy.pt")


def test_import_of_a_torchscript_file_says_how_to_convert_it(tmp_path, capsys):
    path = tmp_path / "policy.pt"
    path.write_bytes(b"PK\x03\x04")
    assert main(["policy", "import", str(path), "--out", str(tmp_path / "out")]) == 2
    assert "downbeat policy convert" in capsys.readouterr().err
