"""Random inputs for a scope: those of skilled operators, of beginners, and inputs that no operator should make."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator
from dataclasses import replace

import numpy as np

from carina.scopes import ScopeDrive, ScopePreset, ScopeState, scope_preset, scope_presets

SCOPES = (*scope_presets(), replace(scope_preset("ebus"), name="thickest", tip_mm=7.8, tube_mm=7.8))
"""Scopes of the library, and a last one that is too thick for all airways except the widest."""
KINDS = ("wander", "push", "fast", "retreat", "stops", "roll", "jump", "press")
"""Kinds of random input, by the names of the generators below."""
DT_S = 1.0 / 60.0
"""Time between two samples of the input, s."""

Hand = Generator[tuple[float, float, float], ScopeState, None]
"""Generator that receives the state of a scope and yields the next sample.

A sample consists of insertion (mm), roll and flexion (radians). The first yielded value is ignored.
"""


def scope_of(run: int) -> ScopePreset:
    """Return the scope of a run; consecutive runs use the scopes of the library in turn."""
    return SCOPES[run % len(SCOPES)]


def kind_of(run: int) -> str:
    """Return the kind of input of a run; the kinds alternate so that each kind meets each scope."""
    return KINDS[run % len(KINDS)]


def random_samples(kind: str, drive: ScopeDrive, rng: np.random.Generator, num_samples: int) -> Iterator[ScopeState]:
    """Drive a placed scope with random input and yield the state after each sample; the time step is ``DT_S``."""
    low, high = drive.flexion_range_rad
    hand = _HANDS[kind](low, high, rng)
    next(hand)
    state = drive.state
    for _ in range(num_samples):
        insertion, roll, flexion = hand.send(state)
        state = drive.drive(insertion, roll, float(np.clip(flexion, low, high)), DT_S)
        yield state


def _wander(low: float, high: float, rng: np.random.Generator) -> Hand:
    """Yield small random steps that advance or withdraw on average, with a flexion that returns slowly to 0."""
    push, sway = rng.normal(0.3, 0.6), rng.uniform(0.02, 0.2)
    roll = flexion = 0.0
    state = yield (0.0, 0.0, 0.0)
    while True:
        roll += rng.normal(0.0, 0.1)
        flexion = 0.98 * flexion + rng.normal(0.0, sway)
        flexion = min(max(flexion, low), high)
        state = yield state.insertion_mm + push + rng.normal(0.0, 0.8), roll, flexion


def _push(low: float, high: float, rng: np.random.Generator) -> Hand:
    """Yield a steady advance with little steering, whatever is in front of the tip."""
    speed = rng.uniform(0.5, 3.0)
    roll, flexion = rng.uniform(-math.pi, math.pi), rng.normal(0.0, 0.4)
    state = yield (0.0, 0.0, 0.0)
    while True:
        roll += rng.normal(0.0, 0.05)
        flexion += rng.normal(0.0, 0.05)
        state = yield state.insertion_mm + speed, roll, flexion


def _fast(low: float, high: float, rng: np.random.Generator) -> Hand:
    """Yield advances and withdrawals at 200 to 900 mm/s, with an equally fast flexion."""
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
    """Yield a withdrawal with a bent tip, which operators must not make."""
    speed = rng.uniform(1.0, 12.0)
    roll, flexion = rng.uniform(-1.0, 1.0), 0.0
    bend = rng.choice([low, high]) * rng.uniform(0.3, 1.0)
    state = yield (0.0, 0.0, 0.0)
    while True:
        roll += rng.normal(0.0, 0.1)
        flexion += 0.15 * (bend - flexion)
        state = yield state.insertion_mm - speed * rng.uniform(0.0, 1.5), roll, flexion


def _stops(low: float, high: float, rng: np.random.Generator) -> Hand:
    """Yield a flexion that moves from one limit to the other."""
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
    """Yield a continuous rotation with a bent tip during an advance."""
    rate, speed = rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 1.5), rng.uniform(-0.3, 1.5)
    flexion = rng.uniform(low, high)
    roll = 0.0
    state = yield (0.0, 0.0, 0.0)
    while True:
        roll += rate
        state = yield state.insertion_mm + speed, roll, flexion


def _jump(low: float, high: float, rng: np.random.Generator) -> Hand:
    """Yield jumps to any insertion, roll and flexion within one sample, each followed by a pause."""
    state = yield (0.0, 0.0, 0.0)
    while True:
        far = rng.normal(0.0, 60.0)
        insertion, roll, flexion = state.insertion_mm + far, rng.uniform(-9.0, 9.0), rng.uniform(low, high)
        for _ in range(int(rng.integers(1, 5))):
            state = yield insertion, roll, flexion


def _press(low: float, high: float, rng: np.random.Generator) -> Hand:
    """Yield a tip that is bent against the wall and then slides along the wall in both directions."""
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
