"""Integrity of the solution for people and machines: protection levels, sources in use and at fault."""

import math

from ins_nav.navigator.delayed import DelayedNavigator


def integrity(navigator: DelayedNavigator) -> tuple[int, str, dict[str, str]]:
    """Level (0 OK, 1 warning, 2 error), one line, and the values of the status on topic ``integrity``.

    Parameters
    ----------
    navigator : DelayedNavigator
        Protection levels are of its solution, `settled_ns`.
    """
    if navigator.filter is None:
        return 1, f"no solution: {navigator.phase.value}", {}
    bank = navigator.bank
    level = bank.protection_level()
    faults, contradictions = bank.hypotheses.suspects, bank.separation.contradictions()
    values = {
        "horizontal protection level": f"{level.horizontal:.3f} m",
        "vertical protection level": f"{level.height:.3f} m",
        "heading protection level": f"{math.degrees(level.heading):.4f} deg",
        "worst case of horizontal, vertical, heading": ", ".join(name or "noise" for name in level.sources),
        "sources in use": ", ".join(name for name in bank.separation.sources if name not in faults) or "none",
        "sources at fault": ", ".join(f"{name} ({count} rejected)" for name, count in faults.items()) or "none",
        "sources that contradict the others": ", ".join(
            f"{each.source} ({each.separation:.3g} m, {each.height:.3g} m up)" for each in contradictions
        )
        or "none",
        "IMU": "on probation" if bank.hypotheses.probation else "in use",
    }
    reasons = []
    if bank.hypotheses.failed:
        reasons.append("the solution had failed and follows the aids")
    if bank.hypotheses.probation:
        reasons.append("the IMU is on probation")
    reasons += [f"{name} is rejected" for name in faults]
    reasons += [f"{each.source} contradicts the others by {each.separation:.3g} m" for each in contradictions]
    return (1, "; ".join(reasons), values) if reasons else (0, "no fault", values)
