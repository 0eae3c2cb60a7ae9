"""Error-controlled integration of the drive: stiff in contact, smooth in the gap, any validated drive.

Each step is taken by the `explicit` method, or by the `implicit` one while stiff motion holds the explicit one down
to steps far shorter than its accuracy needs. The equations of a plain drive are linear wherever its contact force is;
there a power `series` gives a practically exact solution.

Dry friction changes the equations when a shaft comes to rest, reverses or breaks away. No step crosses such an event:
`friction` finds it within the step, and the step is taken again up to there. A shaft that sticks has a speed of
exactly 0.

A drive with effects is integrated in the same way, with the equations of `effects.equations`, in its whole state.
"""

import math
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numba
import numpy as np

from backlash_ros.drivetrain.constants import PLANT_TYPE, PlantConstants
from backlash_ros.drivetrain.contact import Contact, nowhere_linear, one_piece
from backlash_ros.drivetrain.effects.amplifier import amplified
from backlash_ros.drivetrain.effects.equations import real_equations
from backlash_ros.drivetrain.effects.explicit import real_explicit
from backlash_ros.drivetrain.effects.implicit import real_implicit
from backlash_ros.drivetrain.effects.kinks import real_kinks
from backlash_ros.drivetrain.effects.state import WHOLE, begin
from backlash_ros.drivetrain.motion.dynamics import (
    SLIDES,
    Acting,
    ContactOf,
    SpeedSlopes,
    equations_with,
    is_plain,
    load_rubs,
    motor_rubs,
)
from backlash_ros.drivetrain.motion.explicit import Step, explicit_with
from backlash_ros.drivetrain.motion.friction import FirstEvent, Friction, Slips, Switch, friction_by, friction_with
from backlash_ros.drivetrain.motion.implicit import implicit_with
from backlash_ros.drivetrain.motion.kinks import FirstKink, kinks_with
from backlash_ros.drivetrain.motion.series import ROOM, SeriesStep, series_with
from backlash_ros.drivetrain.parameters import Drive
from backlash_ros.foundation.compiled import compiled, specialize, unbound
from backlash_ros.foundation.record import Array, Record, row_of, size_of, view_of
from backlash_ros.foundation.signals import CURRENT, STATE_NAMES, PlantState

_types: Any = numba.types

DEFAULT_TOLERANCE = 1e-9
"""Relative error allowed per step: of angles to the narrowest gap, of speeds to the no-load speed, of the current to
the stall current, of energies to their own size and the motor's kinetic energy at its no-load speed.
"""

DONE, STEP_TOO_SMALL, TOO_MANY_STEPS = range(3)


class IntegrationMemory(Record):
    """What `advance` stores from call to call; room to work in follows."""

    step_size: float = 0.0  # of the next step, s
    peak_force: float = 0.0  # largest magnitude of the contact force since it was set to 0, N
    stiff: float = 0.0  # whether the implicit method is used
    account: float = 0.0  # whether the energies are integrated
    begun: float = 0.0  # whether a drive with effects has its whole state


integration_at = view_of(IntegrationMemory)
_TRIAL = size_of(IntegrationMemory)
"""Where the room for the state at the end of a step begins."""
_WHOLE = _TRIAL + WHOLE
"""Where the whole state of a drive with effects begins."""
_WORK = _WHOLE + WHOLE
"""Where the room of `series` begins."""

Advance = Callable[[PlantConstants, PlantState, Array, float, float, float, float], tuple[int, float]]
ADVANCE_SIGNATURE: Any = _types.Tuple((_types.int64, _types.float64))(
    PLANT_TYPE, *[_types.float64[::1]] * 2, *[_types.float64] * 4
)
"""numba's signature of `Advance`."""

_PLAIN = False
"""Whether the drive is plain: `integrator_with` binds it."""
_KINKS = False
"""Whether its contact law has kinks: `integrator_with` binds it."""
_HAS_SERIES = False
"""Whether it also has linear pieces: `integrator_with` binds it."""
_EFFECTS = False
"""Whether the drive has effects: `integrator_with` binds it."""
_STATES = 7
"""How many states it has: `integrator_with` binds it."""

_STEPS_AT_MOST = 200_000
_SHORTEST = 1e-13
"""Smallest step, as a share of the duration: below it, time would not advance."""
_TRIES = 20
"""Steps towards one event before the event is taken as reached."""
_NEAR = 1e-6
"""Share of a step within which an event is no longer searched: there was none, or the next step meets it."""
_BEHIND = 1e-6
"""Share of a step that may lie behind a kink."""
_MANY = 16
"""Explicit steps in one call before stiffness is tested, then steps held down by stiffness until the method changes."""
_HELD_DOWN = 2.0
"""Step times the fastest rate above which stiffness limits an explicit step; beyond 5 it would be unstable."""
_WORTH_IT = 15.0
"""Step times the fastest rate above which an implicit step is worth more than explicit ones."""

REASONS = {STEP_TOO_SMALL: "the step size fell below rounding", TOO_MANY_STEPS: "too many steps"}


class IntegrationError(RuntimeError):
    """The equations of motion could not be integrated to the wanted accuracy."""

    def __init__(self, reason: str, time: float, state: Array) -> None:
        listed = ", ".join(f"{name} = {value:.9g}" for name, value in zip(STATE_NAMES, state[:5], strict=True))
        super().__init__(f"integration stopped at t = {time:.9g} s: {reason} ({listed})")
        self.time = time
        self.state = state.copy()


def integration_memory(*, account: bool = False) -> Array:
    """Return the initial memory of `Advance`: an `IntegrationMemory`.

    With ``account`` the energies are integrated, too, by an integrator made for it: see `signals.PlantState`.
    """
    return np.append(row_of(IntegrationMemory, account=account), np.zeros(2 * WHOLE + ROOM))


@compiled
def _growth(error: float, rejected: bool, explicit: bool) -> float:
    """Return next step over this step, from the error over the tolerance and whether the last step was rejected."""
    if not math.isfinite(error):
        return 0.1
    root = math.sqrt(math.sqrt(max(error, 1e-12)))
    growth = min(6.0, max(0.2, 0.9 / (math.sqrt(root) if explicit else root)))
    return min(growth, 1.0) if rejected and error <= 1.0 else growth


_explicit: Step = unbound
_implicit: Step = unbound
_series: SeriesStep = unbound
_speed_slopes: Callable[[PlantConstants, Array, Acting], SpeedSlopes] = unbound
_contact_of: ContactOf = unbound
_slips: Slips = unbound
_first_event: FirstEvent = unbound
_switch: Switch = unbound
_first_kink: FirstKink = unbound


@compiled
def whole_state(plant: PlantConstants, state: Array, memory: Array) -> Array:
    """Return the whole state, shape (WHOLE,), of a drive with effects: a view of the integrator's memory."""
    whole = memory[_WHOLE:_WORK]
    if integration_at(memory).begun == 0.0:
        begin(plant, state, whole)
    whole[:7] = state
    return whole


def _rate(plant: PlantConstants, state: Array) -> float:
    """Return about the fastest rate of the motion at ``state``, 1/s."""
    tooth = _contact_of(plant, state)
    per_mass = (
        plant.R1 * plant.R1 * plant.per_inertia_m * max(1.0, plant.forward) + plant.R2 * plant.R2 * plant.per_inertia_l
    )
    return max(plant.rate, abs(tooth[2]) * per_mass, math.sqrt(abs(tooth[1]) * per_mass))


class Search(NamedTuple):
    """Steps towards the next event: how many ``tries``, and whether it is a kink.

    ``size`` of the step to go on with behind it, s, 0 while none is sought; ``ahead``: the time within which it comes.
    """

    tries: int
    size: float
    ahead: float
    to_kink: bool


class Method(NamedTuple):
    """Which method is used; how many explicit steps are ``taken``, and how many are ``held`` down by stiffness."""

    stiff: bool
    taken: int
    held: int


class Event(NamedTuple):
    """Where in a step an event is, 0 to 1, 2 if there is none; whether it is a kink.

    Of either shaft: whether its event of friction has come by the end of the step.
    """

    share: float
    kinked: bool
    come_m: bool
    come_l: bool


_NO_SEARCH = Search(0, 0.0, 0.0, False)
_NO_EVENT = Event(2.0, False, False, False)


@compiled
def _step_of(h: float, remaining: float, free: bool) -> tuple[float, bool]:
    """Return the next step, s, and whether it is the last; ``free`` of a search, the steps to the end are alike."""
    if h >= remaining * (1.0 - 1e-9):
        return remaining, True
    if free and remaining < 4.0 * h:
        return remaining * (0.5 if remaining <= 2.0 * h else 1.0 / 3.0 if remaining <= 3.0 * h else 0.25), False
    return h, False


@compiled
def _towards(search: Search, event: Event, used: float, shortest: float) -> tuple[Search, float]:
    """Go on with a search for an event within a step of ``used`` s: return also the next step, s."""
    tries, share = search.tries + 1, event.share
    if tries > 4:  # the curve is no cubic: close in from both sides
        share = min(max(share, 0.1), 0.9)
    h = used * share
    # So near that the event is taken as reached by the shortest step.
    if h <= 2.0 * shortest:
        h, tries = 2.0 * shortest, _TRIES
    return Search(tries, max(search.size, used), used, event.kinked), h


@compiled
def _behind(search: Search, event: Event, used: float, h: float, shortest: float) -> tuple[Search, float]:
    """Return what is left of a search after a step that was cut short for an event, and the next step, s."""
    ahead = search.ahead - used
    if event.come_m or event.come_l or search.to_kink or ahead <= _NEAR * search.size:
        return _NO_SEARCH, max(h, search.size)
    # It was too short: teeth that meet push all at once.
    return Search(search.tries, search.size, ahead, search.to_kink), max(0.5 * ahead, 2.0 * shortest)


def _choose(plant: PlantConstants, state: Array, method: Method, used: float) -> Method:
    """Return the method for the steps after one of ``used`` s."""
    stiff, taken, held = method
    if stiff:
        held = held + 1 if used * _rate(plant, state) < _WORTH_IT else 0
        return Method(False, taken, 0) if held > 4 else Method(True, taken, held)
    taken += 1
    if taken > _MANY:
        held = held + 1 if used * _rate(plant, state) > _HELD_DOWN else max(held - 1, 0)
        if held > _MANY:
            return Method(True, taken, 0)
    return Method(False, taken, held)


_choice: Callable[[PlantConstants, Array, Method, float], Method] = unbound


@compiled
def _rubs(plant: PlantConstants) -> bool:
    """Return whether a shaft has dry friction."""
    return motor_rubs(plant) or load_rubs(plant)


def _find_event(
    plant: PlantConstants,
    state: Array,
    trial: Array,
    slopes: tuple[SpeedSlopes, SpeedSlopes],
    acting: Acting,
    used: float,
    tolerance: float,
) -> Event:
    """Return the first event in a step from ``state`` to ``trial``, with the ``slopes`` there."""
    before, after = slopes
    share, come_m, come_l, kinked = 2.0, False, False, False
    if _rubs(plant):
        share, come_m, come_l = _first_event(plant, state, trial, before, after, acting, used, tolerance)
    # Teeth whose friction depends on the flow of power have a kink, too.
    if _KINKS or plant.forward != 1.0 or plant.backward != 1.0:
        kink = _first_kink(plant, state, trial, before, after, acting.slip_m, used)
        kinked = kink < share
        share = min(share, kink + 0.1 * _BEHIND)
    return Event(share, kinked, come_m, come_l)


_event: Callable[[PlantConstants, Array, Array, tuple[SpeedSlopes, SpeedSlopes], Acting, float, float], Event] = unbound


def _go(
    plant: PlantConstants, state: Array, step: Array, acting: Acting, duration: float, tolerance: float
) -> tuple[int, float]:
    """Integrate for ``duration`` s: as `_advance`, with ``acting`` at the start."""
    memory, trial, work = integration_at(step), step[_TRIAL : _TRIAL + _STATES], step[_WORK:]
    looks = _KINKS or (not _PLAIN and _rubs(plant))
    account, shortest = not _PLAIN and memory.account != 0.0, _SHORTEST * duration
    time, h = 0.0, memory.step_size
    if not 0.0 < h <= duration:
        h = duration
    rejected, fresh, search, method = False, True, _NO_SEARCH, Method(memory.stiff != 0.0, 0, 0)
    before, after, status = (0.0, 0.0), (0.0, 0.0), TOO_MANY_STEPS
    for _ in range(_STEPS_AT_MOST):
        remaining = duration - time
        if remaining <= 1e-12 * duration:
            time, status = duration, DONE
            break
        if _HAS_SERIES:
            used, force = _series(plant, state, remaining, acting.command, acting.load_torque, work)
            if used > 0.0:
                time, fresh, memory.peak_force = time + used, True, max(memory.peak_force, force)
                continue
        used, last = _step_of(h, remaining, search.size == 0.0)
        if used <= shortest:
            status = STEP_TOO_SMALL
            break
        if method.stiff:
            error, force = _implicit(plant, state, used, acting, tolerance, account, trial)
        else:
            error, force = _explicit(plant, state, used, acting, tolerance, account, trial)
        growth = _growth(error, rejected, not method.stiff)
        if not error <= 1.0:  # nan too
            h, rejected = used * growth, True
            continue
        event = _NO_EVENT
        if looks:
            if fresh:
                before = _speed_slopes(plant, state, acting)
                fresh = False
            after = _speed_slopes(plant, trial, acting)
            event = _event(plant, state, trial, (before, after), acting, used, tolerance)
            if event.share < 1.0 - (_BEHIND if event.kinked else 1e-9) and search.tries < _TRIES:
                search, h = _towards(search, event, used, shortest)
                continue
        for j in range(_STATES):
            state[j] = trial[j]
        memory.peak_force = max(memory.peak_force, force)
        # The next step begins where this one ends, unless friction switches there.
        fresh, before = event.come_m or event.come_l, after
        # A last step that was cut short to end on time says little about the right size.
        h = used * growth if growth < 1.0 or not last else max(h, used * growth)
        if search.size > 0.0:
            search, h = _behind(search, event, used, h, shortest)
        if event.come_m or event.come_l:
            acting = _switch(plant, state, acting, event.come_m, event.come_l, tolerance)
        rejected = False
        time = duration if last else time + used
        method = _choice(plant, state, method, used)
    memory.step_size, memory.stiff = h, method.stiff
    return status, time


_run: Callable[[PlantConstants, Array, Array, Acting, float, float], tuple[int, float]] = unbound


def _advance(
    plant: PlantConstants,
    state: PlantState,
    step: Array,
    command: float,
    load_torque: float,
    duration: float,
    tolerance: float,
) -> tuple[int, float]:
    """Advance ``state`` in place by ``duration`` seconds under a constant command and load torque (N m).

    Parameters
    ----------
    plant : PlantConstants
    state : shape (7,); on failure the last good one
    step : of `integration_memory`: the step size to try first, s, updated, so that the next call starts well; and the
        largest magnitude of the contact force since the caller last set it to 0, N
    command : voltage, V; if the inductance is infinite, the current, A, which holds from the start
    tolerance : see `DEFAULT_TOLERANCE`

    Returns
    -------
    (status, time) : DONE, STEP_TOO_SMALL or TOO_MANY_STEPS, and how far the state got, s
    """
    if duration <= 0.0:
        return DONE, 0.0
    memory, given = integration_at(step), state
    if _EFFECTS:
        state = whole_state(plant, given, step)  # type: ignore[assignment]
        memory.begun = 1.0
        command = amplified(plant, command)
    if math.isinf(plant.L):
        state[CURRENT] = command
    slip_m = slip_l = SLIDES
    if not _PLAIN and _rubs(plant):
        slip_m, slip_l = _slips(plant, state, load_torque, tolerance)
    status, time = _run(plant, state, step, Acting(command, load_torque, slip_m, slip_l), duration, tolerance)
    memory.peak_force = max(memory.peak_force, abs(_contact_of(plant, state)[0]))
    if _EFFECTS:
        for j in range(7):
            given[j] = state[j]
    return status, time


def integrator_for(drive: Drive, *, account: bool = False) -> Advance:
    """Return `_advance` compiled for the contact law of ``drive``: a value that a compiled loop can take.

    The quicker one for plain drives has no energy account and is not used with ``account``.
    """
    law = type(drive.gear.contact)
    if drive.effects.acts:
        return real_integrator_with(law)  # type: ignore[arg-type]
    return integrator_with(law, is_plain(drive) and not account)  # type: ignore[arg-type]


@cache
def integrator_with(law: type[Contact], plain: bool = False) -> Advance:
    """Return `_advance` compiled for a contact law and for drives that are ``plain``: see `dynamics.is_plain`."""
    equations = equations_with(law)  # type: ignore[arg-type]
    return _bound(
        law,
        Parts(
            equations.contact_of,
            equations.speed_slopes,
            specialize(_rate, _contact_of=equations.contact_of),
            explicit_with(law, plain),  # type: ignore[arg-type]
            implicit_with(law),  # type: ignore[arg-type]
            kinks_with(law),  # type: ignore[arg-type]
            friction_with(law),  # type: ignore[arg-type]
        ),
        fused=True,
        _PLAIN=plain,
        _HAS_SERIES=plain and law.linear is not nowhere_linear,
    )


@cache
def real_integrator_with(law: type[Contact]) -> Advance:
    """Return `_advance` compiled for a contact law and for drives with effects."""
    equations = real_equations(law)  # type: ignore[arg-type]
    return _bound(
        law,
        Parts(
            equations.contact_of,
            equations.speed_slopes,
            equations.rate_of,
            real_explicit(law),  # type: ignore[arg-type]
            real_implicit(law),  # type: ignore[arg-type]
            real_kinks(law),  # type: ignore[arg-type]
            friction_by(equations.held_torque),
        ),
        fused=False,
        _EFFECTS=True,
        _STATES=WHOLE,
    )


class Parts(NamedTuple):
    """What an integrator consists of, compiled for a contact law."""

    contact_of: ContactOf
    speed_slopes: Callable[[PlantConstants, Array, Acting], SpeedSlopes]
    rate: Callable[[PlantConstants, Array], float]
    explicit: Step
    implicit: Step
    first_kink: FirstKink
    friction: Friction


def _bound(law: type[Contact], parts: Parts, *, fused: bool, **values: Any) -> Advance:
    """Return `_advance` compiled with its parts and with ``values`` for the constants of this file."""
    friction, kinks = parts.friction, law.piece is not one_piece
    event = specialize(
        _find_event,
        fused=fused,
        inlined=True,
        _first_event=friction.first_event,
        _first_kink=parts.first_kink,
        _KINKS=kinks,
    )
    run = specialize(
        _go,
        fused=fused,
        _series=series_with(law),  # type: ignore[arg-type]
        _explicit=parts.explicit,
        _implicit=parts.implicit,
        _speed_slopes=parts.speed_slopes,
        _event=event,
        _switch=friction.switch,
        _choice=specialize(_choose, fused=fused, inlined=True, _rate=parts.rate),
        _KINKS=kinks,
        **values,
    )
    return specialize(
        _advance,
        ADVANCE_SIGNATURE,
        fused=fused,
        _run=run,
        _slips=friction.slips,
        _contact_of=parts.contact_of,
        **values,
    )
