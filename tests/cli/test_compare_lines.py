"""What `bench compare` says beside its table."""

from types import SimpleNamespace

import pytest

from bench.cli.rendering.printing import lines
from bench.commands import Compared


@pytest.mark.parametrize(("floor_dph", "said"), [(1.0, True), (0.12, False), (float("nan"), False)])
def test_a_noise_floor_above_the_error_is_said_to_be_an_upper_bound(floor_dph, said):
    score = SimpleNamespace(
        model=SimpleNamespace(name="spline"),
        rms_dph=0.1,
        held_out=SimpleNamespace(rms_dph=0.11),
    )
    comparison = SimpleNamespace(
        scores=(score,), floor_dph=floor_dph, interval_s=30.0, by_counts="", constants="", spikes="", refused=(),
        warnings=(),
    )  # fmt: skip
    texts = [line for line in lines(Compared(comparison)) if isinstance(line, str)]
    assert any("an upper bound here" in text for text in texts) == said
