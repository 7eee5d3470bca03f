"""A run: read-only arrays, windows and segments."""

from __future__ import annotations

import numpy as np
import pytest

from undertow.errors import UndertowError
from undertow.identification.logs.run import Run


def _run(t, **channels):
    return Run(name="r", t=np.array(t, dtype=float), channels=channels)


def test_arrays_are_copies_that_cannot_be_changed():
    mine = np.arange(3.0)
    run = _run([0, 1, 2], u=mine)
    mine[0] = 9
    assert run.channels["u"][0] == 0
    with pytest.raises(ValueError, match="read-only"):
        run.t[0] = 1


def test_a_channel_of_another_length_is_refused():
    with pytest.raises(UndertowError, match=r"channel 'u' has shape \(2,\), t has \(3,\)"):
        _run([0, 1, 2], u=[1, 2])


def test_matrix_names_what_is_missing():
    run = _run([0, 1], u=[1, 2], v=[3, 4])
    np.testing.assert_array_equal(run.matrix(["v", "u"]), [[3, 1], [4, 2]])
    assert run.matrix([]).shape == (2, 0)
    with pytest.raises(UndertowError, match="no channel 'w': it has u, v"):
        run.matrix(["w"])


def test_slice_keeps_both_ends():
    run = _run([0, 1, 2, 3], u=[0, 1, 2, 3]).slice(1, 2)
    np.testing.assert_array_equal(run.t, [1, 2])
    np.testing.assert_array_equal(run.channels["u"], [1, 2])
    with pytest.raises(
        UndertowError, match="no sample in the time window 5 to inf s: it lasts from 1 to 2 s"
    ):
        run.slice(5)


def test_segments_end_at_long_steps_and_on_request_at_missing_samples():
    nan = np.nan
    run = _run([0, 1, 2, 3, 7.9, 14, 15], u=[0, nan, 1, 2, 3, nan, 4])
    assert run.segments() == [slice(0, 5), slice(5, 7)]
    assert run.segments(["u"]) == [slice(0, 1), slice(2, 5), slice(6, 7)]
    assert run.segments(across=run.t[5] - run.t[4]) == [slice(0, 7)]
    assert _run([3.0], u=[1]).segments() == [slice(0, 1)]
    assert _run([0, 1], u=[nan, nan]).segments("u") == []
