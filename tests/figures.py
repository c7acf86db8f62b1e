"""What figures of matplotlib show."""

import numpy as np
from matplotlib.colors import to_hex


def assert_lines(axes, *expected):
    """Asserts the lines of a panel in their order; of each, x, y and colour."""
    lines = [line for line in axes.lines if len(line.get_xdata())]
    assert [to_hex(line.get_color()) for line in lines] == [
        to_hex(colour) for *_, colour in expected
    ]
    for line, (x, y, _) in zip(lines, expected, strict=True):
        np.testing.assert_allclose(
            line.get_xydata(), np.transpose(np.broadcast_arrays(x, y)), rtol=1e-12, atol=1e-12
        )


def assert_bars(axes, *expected):
    """Asserts the horizontal bars of a panel in their order; of each, the height of its centre,
    length and colour."""
    bars = [
        (bar.get_y() + 0.5 * bar.get_height(), bar.get_width(), bar.get_facecolor())
        for bar in axes.patches
    ]
    assert [to_hex(colour) for *_, colour in bars] == [to_hex(colour) for *_, colour in expected]
    np.testing.assert_allclose([bar[:2] for bar in bars], [bar[:2] for bar in expected], atol=1e-12)


def texts(ticks_or_texts):
    """The texts of ticks or of a legend."""
    return [each.get_text() for each in ticks_or_texts]
