"""The report's section on the two proofs; every bound is rounded away from the claim that it would help."""

from __future__ import annotations

import math
from collections.abc import Sequence

from baselines.paper.proofs import LargestRate, PeakTorque
from baselines.paper.text.layout import paragraph, table, title
from baselines.tables import printed_above, printed_below


def proofs_section(peaks: Sequence[PeakTorque], rates: Sequence[LargestRate]) -> list[str]:
    """Both proofs."""
    holds = all([*(peak.holds for peak in peaks), *(rate.holds for rate in rates)])
    return [
        *title("Why the published torques are impossible: two proofs"),
        *_peaks(peaks),
        "",
        *_rates(rates),
        "",
        *paragraph(
            f"All four hold: {'yes' if holds else 'NO'}. Proved is that the published torques and the published rates "
            "exclude each other on the published plant. The mean speeds are not touched by it: that they are not met "
            "is found, by simulation of the profiles as calibrated. Lower bounds are rounded down, upper bounds up."
        ),
    ]


def _peaks(peaks: Sequence[PeakTorque]) -> list[str]:
    """Proof 1."""
    cells = [["profile", "theta'", "published", "at least", "sticking", "|theta| < 90 deg", "at", "with"]]
    for peak in peaks:
        cells.append(
            [
                peak.name,
                f"{peak.velocity:g} rad/s",
                f"{peak.published:.4f} N m",
                printed_below(peak.bound, 4),
                printed_below(peak.sticking, 4),
                printed_below(peak.anywhere, 4),
                f"{math.degrees(peak.angle):.1f} deg",
                peak.mode,
            ]
        )
    return [
        *paragraph(
            "Proof 1, at the peak. Where theta' peaks theta'' = 0, and (1) leaves no freedom but the contact. The "
            "motor then gives at least the torque below, for every angle of the published swing, either direction of "
            "slip, stick, and either normal force; the margin between the samples is included."
        ),
        "",
        *table(cells),
    ]


def _rates(rates: Sequence[LargestRate]) -> list[str]:
    """Proof 2."""
    cells = [["profile", "limit", "published", "theta' below", "from -60 deg", "needed at least", "enough", "if c = 0"]]
    for rate in rates:
        cells.append(
            [
                rate.name,
                f"{rate.torque:.4f} N m",
                f"{rate.published:g} rad/s",
                f"{printed_above(rate.bound, 3)} rad/s",
                printed_above(rate.from_start, 3),
                f"{printed_below(rate.torque_needed, 3)} N m",
                f"{printed_above(rate.torque_enough, 3)} N m",
                f"{printed_above(rate.undamped, 2)} rad/s",
            ]
        )
    return [
        *paragraph(
            "Proof 2, in the phase plane. On every stretch with theta' > 0, d(theta'^2)/dtheta = 2 theta'', which is "
            "largest at full torque and in the contact mode that favours it. The solution of that equation from rest "
            "is an envelope that no motion with |u| within the limit crosses, whatever the reference, the law or the "
            "gains."
        ),
        "",
        *table(cells, last_left=False),
        "",
        *paragraph(
            "'theta' below': from rest anywhere within the published swing to either side. 'needed': no torque within "
            "it takes the pendulum from rest at -60 degrees to the published velocity, by the certified envelope; "
            "'enough': a constant torque that does, by simulation. 'if c = 0': the envelope from -60 degrees without "
            "the damper, which would admit the published velocity: the damper is what the published torques cannot "
            "pay for."
        ),
    ]
