"""Text of a turn: clock hours, distances and moves of the hand."""

from __future__ import annotations

from collections.abc import Sequence

from carina.plan.hand_moves import Move
from carina.plan.routes.main_carina import carina_words

STILL_DEG = 0.5
STILL_MM = 0.5
"""Limit in degrees or mm below which a text omits a turn, a flexion or an advance."""

GRADUAL_MM, GRADUAL_DEG = 5.0, 20.0
"""Limits of one step of a gradual move: advance in mm; turn and change of flexion in degrees."""


def hour_words(hour: int | None) -> str:
    """Return a clock hour as text, as the window shows it."""
    return "straight ahead" if hour is None else f"{hour} o\u2019clock"


def place_words(from_carina_mm: float | None, from_fork_mm: float, depth_mm: float | None, first: bool) -> str:
    """Return a distance along the route as text for the beginning of a line.

    Parameters
    ----------
    from_carina_mm
        Distance from the main carina; None if there is no main carina.
    from_fork_mm
        Distance from the previous fork.
    depth_mm
        Depth at nose or mouth; None if it is not known.
    first
        Whether the turn is the first one of the route.
    """
    if from_carina_mm is None:
        since = "from the start of the route" if first else "past the previous fork"
        return f"At {from_fork_mm:.0f} mm {since}"
    where = carina_words(from_carina_mm)
    return with_depth(where.capitalize() if where.startswith("at ") else f"At {where}", depth_mm)


def with_depth(where: str, depth_mm: float | None) -> str:
    """Return the text of a position on the route, with the insertion depth at nose or mouth if it is known."""
    return (
        where if depth_mm is None else f"{where} (about {round(depth_mm / 5.0) / 2.0:g} cm on the scope, an estimate)"
    )


def moves_words(moves: Sequence[Move]) -> str:
    """Return moves of the hand as text.

    Consecutive advances with one roll and flexion are combined. Consecutive short advances between which roll and
    flexion change a little, in one direction each, are one gradual move.
    """
    text = []
    lever: float | None = None
    for run in _gradual_runs(_steps(moves)):
        turn_deg, flexion_deg = sum(step.turn_deg for step in run), run[-1].flexion_deg
        advance_mm = sum(step.advance_mm for step in run)
        words = []
        if abs(turn_deg) >= STILL_DEG:
            words.append(f"rotate {abs(turn_deg):.0f}\u00b0 {'clockwise' if turn_deg > 0.0 else 'counterclockwise'}")
        if lever is None or abs(flexion_deg - lever) >= STILL_DEG:
            words.append(_flexion_words(flexion_deg))
        if words and len(run) > 1:
            words[0] = f"gradually {words[0]}"
        if abs(advance_mm) >= STILL_MM:
            words.append(f"{'advance' if advance_mm > 0.0 else 'withdraw'} {abs(advance_mm):.0f} mm")
        lever = flexion_deg
        if words:
            text.append(", ".join(words))
    return "; then ".join(text)


def moves_sum_words(moves: Sequence[Move]) -> str:
    """Return the sum of moves of the hand as text: the whole turn, the last flexion and the whole advance."""
    if not moves:
        return ""
    turn_deg, advance_mm = (sum(getattr(move, name) for move in moves) for name in ("turn_deg", "advance_mm"))
    return f"in all {moves_words([Move(turn_deg, moves[-1].flexion_deg, advance_mm)])}"


def _steps(moves: Sequence[Move]) -> list[Move]:
    """Return moves in which consecutive advances with one roll and flexion are combined."""
    steps: list[Move] = []
    for move in moves:
        held = (
            bool(steps) and abs(move.turn_deg) < STILL_DEG and abs(move.flexion_deg - steps[-1].flexion_deg) < STILL_DEG
        )
        if held:
            last = steps[-1]
            steps[-1] = Move(last.turn_deg + move.turn_deg, last.flexion_deg, last.advance_mm + move.advance_mm)
        else:
            steps.append(move)
    return steps


def _gradual_runs(steps: Sequence[Move]) -> list[list[Move]]:
    """Return consecutive steps in runs; a run of several steps is one gradual move of roll and flexion."""
    runs: list[list[Move]] = []
    lever = turning = bending = 0.0
    was_small = False
    for step in steps:
        change = step.flexion_deg - lever
        is_small = (
            0.0 < step.advance_mm <= GRADUAL_MM and abs(step.turn_deg) <= GRADUAL_DEG and abs(change) <= GRADUAL_DEG
        )
        if is_small and was_small and step.turn_deg * turning >= 0.0 and change * bending >= 0.0:
            runs[-1].append(step)
        else:
            runs.append([step])
            turning = bending = 0.0
        turning, bending = step.turn_deg or turning, change or bending
        lever, was_small = step.flexion_deg, is_small
    return runs


def _flexion_words(flexion_deg: float) -> str:
    if abs(flexion_deg) < STILL_DEG:
        return "tip straight"
    return f"flex {'up' if flexion_deg > 0.0 else 'down'} {abs(flexion_deg):.0f}\u00b0"


def joined(words: Sequence[str]) -> str:
    """Return words joined as an enumeration in a sentence."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"
