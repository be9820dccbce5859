"""Fluids as a case asks for them: what it does not need is not imported."""

import sys

from tests.two_phase.scenes import layers, scene


def test_what_a_scene_does_not_need_is_not_there(monkeypatch):
    for name in [m for m in sys.modules if m.startswith("isphcli.two_phase.")]:
        monkeypatch.delitem(sys.modules, name)
    _, _, state, stepper, _ = scene(layers(1 / 8))  # two fluids that differ in name only, without tension
    config = stepper.configure(state.x, phi=state.phi)
    assert config.terms.ops is config.ops
    assert not [name for name in sys.modules if name.startswith("isphcli.two_phase.")]
