"""Hands that drive a scope at random: as doctors do, as beginners do, and as nobody should."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator
from dataclasses import replace

import numpy as np

from carina.scopes import ScopeDrive, ScopePreset, ScopeState, scope_preset, scope_presets

# And one that is too thick for all but the widest airways.
SCOPES = (*scope_presets(), replace(scope_preset("ebus"), name="thickest", tip_mm=7.8, tube_mm=7.8))
KINDS = ("wander", "push", "fast", "retreat", "stops", "roll", "jump", "press")
DT_S = 1.0 / 60.0

Hand = Generator[tuple[float, float, float], ScopeState, None]
"""Is sent a state and tells insertion, roll and flexion of the next sample; what it tells first does not count."""


def scope_of(run: int) -> ScopePreset:
    """Every instrument of the library in turn."""
    return SCOPES[run % len(SCOPES)]


def kind_of(run: int) -> str:
    """Every kind of hand with every instrument in turn."""
    return KINDS[run % len(KINDS)]


def random_samples(kind: str, drive: ScopeDrive, rng: np.random.Generator, num_samples: int) -> Iterator[ScopeState]:
    """Drive a scope that is laid already; the state after each sample, ``DT_S`` apart."""
    low, high = drive.flexion_range_rad
    hand = _HANDS[kind](low, high, rng)
    next(hand)
    state = drive.state
    for _ in range(num_samples):
        insertion, roll, flexion = hand.send(state)
        state = drive.drive(insertion, roll, float(np.clip(flexion, low, high)), DT_S)
        yield state


def _wander(low: float, high: float, rng: np.random.Generator) -> Hand:
    """Some push, some draw back; some let the lever go."""
    push, sway = rng.normal(0.3, 0.6), rng.uniform(0.02, 0.2)
    roll = flexion = 0.0
    state = yield (0.0, 0.0, 0.0)
    while True:
        roll += rng.normal(0.0, 0.1)
        flexion = 0.98 * flexion + rng.normal(0.0, sway)
        flexion = min(max(flexion, low), high)
        state = yield state.insertion_mm + push + rng.normal(0.0, 0.8), roll, flexion


def _push(low: float, high: float, rng: np.random.Generator) -> Hand:
    """Pushes on, whatever is before it, and steers a little."""
    speed = rng.uniform(0.5, 3.0)
    roll, flexion = rng.uniform(-math.pi, math.pi), rng.normal(0.0, 0.4)
    state = yield (0.0, 0.0, 0.0)
    while True:
        roll += rng.normal(0.0, 0.05)
        flexion += rng.normal(0.0, 0.05)
        state = yield state.insertion_mm + speed, roll, flexion


def _fast(low: float, high: float, rng: np.random.Generator) -> Hand:
    """200 to 900 mm/s to and fro, the lever as fast."""
    state = yield (0.0, 0.0, 0.0)
    roll = flexion = 0.0
    while True:
        speed = rng.choice([-1.0, 1.0, 1.0]) * rng.uniform(200.0, 900.0)
        bend = rng.uniform(low, high)
        for _ in range(int(rng.integers(2, 8))):
            roll += rng.normal(0.0, 0.3)
            flexion += 0.4 * (bend - flexion)
            state = yield state.insertion_mm + speed * DT_S, roll, flexion


def _retreat(low: float, high: float, rng: np.random.Generator) -> Hand:
    """Draws back with the lever pulled, as one must not."""
    speed = rng.uniform(1.0, 12.0)
    roll, flexion = rng.uniform(-1.0, 1.0), 0.0
    bend = rng.choice([low, high]) * rng.uniform(0.3, 1.0)
    state = yield (0.0, 0.0, 0.0)
    while True:
        roll += rng.normal(0.0, 0.1)
        flexion += 0.15 * (bend - flexion)
        state = yield state.insertion_mm - speed * rng.uniform(0.0, 1.5), roll, flexion


def _stops(low: float, high: float, rng: np.random.Generator) -> Hand:
    """The lever from stop to stop."""
    speed, roll = rng.uniform(-0.5, 1.5), rng.uniform(-math.pi, math.pi)
    rate = rng.uniform(0.05, 0.6)
    flexion, towards = 0.0, rng.choice([low, high])
    state = yield (0.0, 0.0, 0.0)
    while True:
        flexion += float(np.clip(towards - flexion, -rate, rate))
        if flexion == towards:
            towards = low if towards == high else high
        roll += rng.normal(0.0, 0.05)
        state = yield state.insertion_mm + speed, roll, flexion


def _roll(low: float, high: float, rng: np.random.Generator) -> Hand:
    """Turns round and round with a bent tip, pushing."""
    rate, speed = rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 1.5), rng.uniform(-0.3, 1.5)
    flexion = rng.uniform(low, high)
    roll = 0.0
    state = yield (0.0, 0.0, 0.0)
    while True:
        roll += rate
        state = yield state.insertion_mm + speed, roll, flexion


def _jump(low: float, high: float, rng: np.random.Generator) -> Hand:
    """A device that leaps: any insertion, any roll, any flexion in one sample; then it stays for a while."""
    state = yield (0.0, 0.0, 0.0)
    while True:
        far = rng.normal(0.0, 60.0)
        insertion, roll, flexion = state.insertion_mm + far, rng.uniform(-9.0, 9.0), rng.uniform(low, high)
        for _ in range(int(rng.integers(1, 5))):
            state = yield insertion, roll, flexion


def _press(low: float, high: float, rng: np.random.Generator) -> Hand:
    """Bends against the wall, then slides along it both ways."""
    roll, bend = rng.uniform(-math.pi, math.pi), rng.choice([low, high]) * rng.uniform(0.2, 1.0)
    state = yield (0.0, 0.0, 0.0)
    flexion, n = 0.0, 0
    while True:
        flexion += 0.1 * (bend - flexion)
        n += 1
        slide = 1.2 * math.sin(0.25 * n) + rng.normal(0.2, 0.3)
        state = yield state.insertion_mm + slide, roll + 0.3 * math.sin(0.1 * n), flexion


_HANDS: dict[str, Callable[[float, float, np.random.Generator], Hand]] = {
    "wander": _wander,
    "push": _push,
    "fast": _fast,
    "retreat": _retreat,
    "stops": _stops,
    "roll": _roll,
    "jump": _jump,
    "press": _press,
}
