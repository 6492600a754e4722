"""Bodies of the HTTP API, made by `make_models.py` from its description: not edited by hand."""

from __future__ import annotations

from typing import Any, Literal, TypeAlias, TypedDict

from typing_extensions import NotRequired


class Aim(TypedDict):
    """Something that a fit counts."""

    best: NotRequired[int]
    found: NotRequired[int]
    needed: NotRequired[int]
    what: NotRequired[str]


class Answer(TypedDict):
    """The answer to a command that the vehicle accepted; one that it rejected is a [`crate::Problem`] of status 409."""

    command_id: NotRequired[int]
    reason: NotRequired[str]
    revision: NotRequired[int | None]
    stage: NotRequired[str]


class Asked(TypedDict):
    """A plan, TOML."""

    plan: str


class AtGround(TypedDict):
    """Another ground."""

    address: NotRequired[str]
    name: NotRequired[str]


class CalibratedParameter(TypedDict):
    """One fitted number."""

    name: NotRequired[str]
    sigma: NotRequired[float | None]
    unit: NotRequired[str]
    value: NotRequired[float]


class Change(TypedDict):
    """‖ΔK‖/‖K‖ against the gains in use."""

    largest: NotRequired[float | None]
    row: NotRequired[str | None]
    rows: NotRequired[dict[str, float | None]]


class Code(TypedDict):
    """`DELETE /api/v1/session/authenticator`, and `POST /api/v1/pairing`."""

    code: str


Completeness: TypeAlias = Literal['recording', 'complete', 'filling', 'truncated']


class Confirmation(TypedDict):
    """`PUT /api/v1/session/authenticator`: its code is the proof that it works."""

    code: str
    secret: str


class Credentials(TypedDict):
    """`POST /api/v1/session`."""

    code: NotRequired[str]
    name: str
    password: str


class Decoder(TypedDict):
    """`POST decoder`: what solves the secure estimator's program."""

    decoder: str


class Design(TypedDict):
    """A design, or exported gains: those carry what came of their design beside it, which is read past."""

    airframe: NotRequired[str | None]
    certificate: NotRequired[dict[str, Any] | None]
    controller: NotRequired[str | None]
    format: NotRequired[str | None]
    input_weight: NotRequired[list[float] | None]
    k: NotRequired[list[list[float]] | None]
    k_attitude: NotRequired[list[list[float]] | None]
    parameters: NotRequired[dict[str, float]]
    state_weight: NotRequired[list[float] | None]
    tick_rate_hz: NotRequired[float | None]
    units: NotRequired[dict[str, Any] | None]


class Difference(TypedDict):
    """Differences of pairs of flights of the same seed."""

    baseline: NotRequired[int]
    effect: NotRequired[float | None]
    interval: NotRequired[list[float] | None]
    median: NotRequired[float]
    pairs: NotRequired[int]


class Due(TypedDict):
    """One of `GET /api/v1/archive/due`: a flight that retention will delete."""

    bytes: NotRequired[int]
    deleted_unix_us: NotRequired[int | None]
    id: NotRequired[str]
    why: NotRequired[str]


class EnvelopeMultiplier(TypedDict):
    """A detector at one time, and its multiplier."""

    detector: NotRequired[str]
    limit: NotRequired[float]
    multiplier: NotRequired[float]
    sensor: NotRequired[str | None]
    statistics: NotRequired[int]
    time_s: NotRequired[float]


class EnvelopeQuestion(TypedDict):
    """What is asked; what is left out is as usual."""

    axis: NotRequired[str | None]
    climb: NotRequired[bool]
    design: NotRequired[Design]
    horizon_s: NotRequired[float | None]
    more: NotRequired[str | None]
    most: NotRequired[int | None]
    noise_mps2: NotRequired[float | None]
    proof: NotRequired[bool]
    rectified_mps2: NotRequired[float | None]
    sensors: NotRequired[list[str] | None]
    suite: NotRequired[str | None]
    without: NotRequired[list[str]]


class EnvelopeSequence(TypedDict):
    """What is added to the samples of one sensor, one after another."""

    period_s: NotRequired[float]
    sensor: NotRequired[str]
    values: NotRequired[list[float]]


class Estimator(TypedDict):
    """`POST estimator`: which is in the loop."""

    estimator: str


class Expectation(TypedDict):
    """
    What the model of the lanes expects of an attack on one sensor, by the flights of the condition as planned. Of several sensors it
    says nothing: the model has any of them excluded, [`Condition::detected`] all.
    """

    differs: NotRequired[bool]
    note: NotRequired[str]
    probability: NotRequired[float | None]


class ExperimentFlight(TypedDict):
    """One flight."""

    condition: NotRequired[int]
    index: NotRequired[int]
    lost: NotRequired[str]
    seed: NotRequired[int]
    values: NotRequired[list[float | None]]


class ExperimentFlights(TypedDict):
    """Flights of an experiment, some of them."""

    flights: NotRequired[list[ExperimentFlight]]
    total: NotRequired[int]


class Fit(TypedDict):
    """`POST /api/v1/calibrations`: what to fit, from exactly one of `flight`, `csv` and `vehicle`."""

    accelerometer: NotRequired[str | None]
    air_density_kgpm3: NotRequired[float | None]
    csv: NotRequired[str | None]
    first_half: NotRequired[bool]
    flight: NotRequired[str | None]
    from_s: NotRequired[float | None]
    gravity_mps2: NotRequired[float | None]
    imu: NotRequired[int | None]
    kind: str
    name: NotRequired[str | None]
    propeller: NotRequired[str | None]
    to_s: NotRequired[float | None]
    vehicle: NotRequired[str | None]


class Fleet(TypedDict):
    """What grounds share."""

    archive: NotRequired[str | None]
    archive_error: NotRequired[str | None]
    grounds: NotRequired[list[str] | None]
    index: NotRequired[str | None]
    live_error: NotRequired[str | None]
    name: NotRequired[str]
    waiting: NotRequired[int]


class Flown(TypedDict):
    """A step flown on the nonlinear vehicle; curves are columns of equal length."""

    largest_command: NotRequired[list[float | None]]
    output: NotRequired[str]
    overshoot_percent: NotRequired[float | None]
    response: NotRequired[list[float | None]]
    rise_time_s: NotRequired[float | None]
    saturated_s: NotRequired[float | None]
    setpoint: NotRequired[list[float | None]]
    settling_time_s: NotRequired[float | None]
    size: NotRequired[float]
    stayed: NotRequired[bool | None]
    t_s: NotRequired[list[float | None]]
    unit: NotRequired[str]


class FlownByHand(TypedDict):
    """What was said of a flight, and by whom."""

    accepted: NotRequired[bool]
    flight: NotRequired[str]
    index: NotRequired[int]
    reason: NotRequired[str]
    unix_us: NotRequired[int]
    who: NotRequired[str]


class Imported(TypedDict):
    """`POST /api/v1/flights`: a recording from elsewhere is a flight now."""

    already: NotRequired[bool]
    flight: NotRequired[str]
    notes: NotRequired[list[str]]


class Labels(TypedDict):
    """`PATCH /api/v1/flights/{id}`; what is absent stays."""

    name: NotRequired[str | None]
    notes: NotRequired[str | None]


class Lease(TypedDict):
    """Who holds control of a vehicle."""

    holder: NotRequired[str | None]
    taken_from: NotRequired[str | None]


class Margin(TypedDict):
    """Margins of one input."""

    crossover_radps: NotRequired[float | None]
    delay_s: NotRequired[float | None]
    gain_down: NotRequired[float | None]
    gain_up: NotRequired[float | None]
    input: NotRequired[str]
    peak_sensitivity: NotRequired[float | None]
    phase_rad: NotRequired[float | None]


class Matrix(TypedDict):
    """A matrix, row by row."""

    columns: NotRequired[int]
    rows: NotRequired[int]
    values: NotRequired[list[float]]


class Measure(TypedDict):
    """A column of numbers."""

    about: NotRequired[str]
    name: NotRequired[str]


class Mode(TypedDict):
    """`POST mode`."""

    mode: str


class NewAuthenticator(TypedDict):
    """`POST /api/v1/session/authenticator`: a new one, which counts once a code of it has come back."""

    secret: NotRequired[str]
    svg: NotRequired[str]
    url: NotRequired[str]


class Opened(TypedDict):
    """A flight of an experiment, recorded."""

    flight: NotRequired[str]


class Outline(TypedDict):
    """
    The altitude of a flight, for a picture of some hundred pixels: true where truth is recorded, else as estimated in the
    loop.
    """

    altitude_cm: NotRequired[list[list[int] | None]]
    from_s: NotRequired[float]
    step_s: NotRequired[float]


class Parameter(TypedDict):
    """A parameter and what it may be."""

    max: NotRequired[float]
    min: NotRequired[float]
    name: NotRequired[str]
    unit: NotRequired[str]
    value: NotRequired[float]


class Part(TypedDict):
    """So many of so many."""

    count: NotRequired[int]
    interval: NotRequired[list[float]]
    of: NotRequired[int]


class PlannedAttack(TypedDict):
    """One attack."""

    channel: NotRequired[str]
    duration_s: float
    instance: int
    kind: str
    magnitude: NotRequired[float]
    seed: NotRequired[int]
    sensor: str
    sequence: NotRequired[list[float]]
    sequence_period_s: NotRequired[float | None]
    start_s: float


class Policy(TypedDict):
    """What the vehicle's loops must forgive."""

    change_max: NotRequired[float]
    delay_min_s: NotRequired[float]
    gain_down_max: NotRequired[float]
    gain_up_min: NotRequired[float]
    name: NotRequired[str]
    phase_min_rad: NotRequired[float]
    sensitivity_max: NotRequired[float]
    slowest_pole_per_s: NotRequired[float]
    unit_step_max: NotRequired[float]


class PreparedAttack(TypedDict):
    """An attack, and what is expected of it with lanes in the loop."""

    altitude_m: NotRequired[float | None]
    attacks: NotRequired[list[PlannedAttack]]
    note: NotRequired[str]
    position_m: NotRequired[float | None]
    probability: NotRequired[float | None]
    tilt_rad: NotRequired[float | None]
    velocity_mps: NotRequired[float | None]


class Problem(TypedDict):
    """
    The body of every error, `application/problem+json` (RFC 9457): [`Problem::code`] is stable, [`Problem::detail`] is
    for people.
    """

    code: NotRequired[str]
    command_id: NotRequired[int | None]
    detail: NotRequired[str]
    holder: NotRequired[str | None]
    revision: NotRequired[int | None]
    status: NotRequired[int]
    title: NotRequired[str]
    type: NotRequired[str]


class Recording(TypedDict):
    """`POST recording`."""

    on: bool


class Replay(TypedDict):
    """`POST replay`."""

    speed: float
    step: NotRequired[int]


class Residual(TypedDict):
    """What the model leaves."""

    unit: NotRequired[str]
    value: NotRequired[float | None]


class Revision(TypedDict):
    """One push of gains, as the ground keeps it."""

    operator: str
    pushed_unix_us: int
    reason: str
    revision: int
    stage: str


Role: TypeAlias = Literal['viewer', 'operator', 'attacker', 'admin']


class Said(TypedDict):
    """What is said of a flight."""

    accepted: bool
    flight: str
    index: int
    reason: NotRequired[str]


class Samples(TypedDict):
    """`GET /api/v1/flights/{id}/signal`, `GET /api/v1/vehicles/{id}/signal`: samples, or of each stretch of time the least and the greatest, in their order."""

    samples: NotRequired[int]
    time_s: NotRequired[list[float]]
    value: NotRequired[list[float]]


class Series(TypedDict):
    """Points of one kind in a plot."""

    line: NotRequired[bool]
    name: NotRequired[str]
    points: NotRequired[list[list[float | None]]]


class Session(TypedDict):
    """`GET /api/v1/session`: who asks."""

    name: NotRequired[str | None]
    role: NotRequired[Role | None]
    sign_in_needed: NotRequired[bool]
    signed_in: NotRequired[bool]
    two_steps: NotRequired[bool]


class Setpoint(TypedDict):
    """`POST setpoint`. Absent fields keep their value."""

    altitude_m: NotRequired[float | None]
    pitch_rad: NotRequired[float | None]
    roll_rad: NotRequired[float | None]
    throttle: NotRequired[float | None]
    x_m: NotRequired[float | None]
    y_m: NotRequired[float | None]
    yaw_rad: NotRequired[float | None]


class Share(TypedDict):
    """Largest command of an uncut step of 1 m or 1 rad."""

    output: NotRequired[str]
    share: NotRequired[float | None]
    unit: NotRequired[str]


class Signal(TypedDict):
    """One number of one topic."""

    name: NotRequired[str]
    unit: NotRequired[str]


class Signals(TypedDict):
    """`GET /api/v1/flights/{id}/signals`, `GET /api/v1/vehicles/{id}/signals`."""

    signals: NotRequired[list[Signal]]
    start_s: NotRequired[float]


SignedIn = TypedDict(
    'SignedIn',
    {
        'account': NotRequired[str],
        'begun_s': NotRequired[int],
        'from': NotRequired[str],
        'id': NotRequired[str],
        'seen_s': NotRequired[int],
    },
)


class Simulator(TypedDict):
    """`POST simulator`: what only a simulated vehicle can be given."""

    battery: NotRequired[bool]
    reset: NotRequired[bool]


class Size(TypedDict):
    """What a plan comes to."""

    by_hand: NotRequired[bool]
    conditions: NotRequired[int]
    done: NotRequired[int]
    expected_s: NotRequired[float]
    flights: NotRequired[int]
    id: NotRequired[str]
    repeats: NotRequired[int]


class Spectrum(TypedDict):
    """`GET /api/v1/flights/{id}/spectrum`, `GET /api/v1/vehicles/{id}/spectrum`: Welch's method, Hann windows that overlap by half, one-sided."""

    density: NotRequired[list[float]]
    frequency_hz: NotRequired[list[float]]
    harmonics_hz: NotRequired[list[float]]
    mean: NotRequired[float]
    rate_hz: NotRequired[float]
    rms: NotRequired[float]
    rotor_hz: NotRequired[float | None]
    windows: NotRequired[int]


class Spread(TypedDict):
    """Values of many flights."""

    count: NotRequired[int]
    interval: NotRequired[list[float] | None]
    least: NotRequired[float]
    median: NotRequired[float]
    most: NotRequired[float]
    of_95: NotRequired[float]
    quarter: NotRequired[float]
    three_quarters: NotRequired[float]


class State(TypedDict):
    """How an experiment stands."""

    by_hand: NotRequired[bool]
    description: NotRequired[str]
    done: NotRequired[int]
    error: NotRequired[str | None]
    flights: NotRequired[int]
    id: NotRequired[str]
    left_s: NotRequired[float | None]
    made_unix_us: NotRequired[int]
    name: NotRequired[str]
    own: NotRequired[bool]
    per_s: NotRequired[float | None]
    running: NotRequired[bool]


class Step(TypedDict):
    """One setpoint step of a flight."""

    from_m: NotRequired[float]
    interrupted: NotRequired[bool]
    overshoot_percent: NotRequired[float]
    rise_time_s: NotRequired[float | None]
    settling_time_s: NotRequired[float | None]
    start_s: NotRequired[float]
    steady_error_m: NotRequired[float | None]
    to_m: NotRequired[float]


class Steps(TypedDict):
    """Sizes of the steps."""

    x_m: NotRequired[float | None]
    y_m: NotRequired[float | None]
    yaw_rad: NotRequired[float | None]
    z_m: NotRequired[float | None]


class Storage(TypedDict):
    """What the recordings take and leave."""

    flights: NotRequired[int]
    free_bytes: NotRequired[int]
    used_bytes: NotRequired[int]


class Taken(TypedDict):
    """
    `GET /api/v1/vehicles/{id}/calibration`: samples taken so far, and what the fit asks for, counted by the fit's own code. Directions
    are unit vectors in the body frame FLU.
    """

    aims: NotRequired[list[Aim]]
    bands: NotRequired[int]
    field: NotRequired[list[float] | None]
    imu: NotRequired[int]
    kind: NotRequired[str]
    poses: NotRequired[list[list[float]]]
    problem: NotRequired[str]
    ready: NotRequired[bool]
    samples: NotRequired[int]
    sectors: NotRequired[list[bool]]
    span_s: NotRequired[float]
    still: NotRequired[float]
    undetermined: NotRequired[str]
    up: NotRequired[list[float] | None]


class Taking(TypedDict):
    """`POST /api/v1/vehicles/{id}/calibration`: take samples for this; what was taken before is dropped."""

    imu: NotRequired[int | None]
    kind: str


class Trajectory(TypedDict):
    """`POST trajectory` flies a path from where the setpoint is; `DELETE` stops it."""

    altitude_m: NotRequired[list[float]]
    duration_s: NotRequired[float | None]
    hold_s: NotRequired[float | None]
    period_s: NotRequired[float | None]
    shape: str
    size_m: NotRequired[float | None]
    speed_mps: NotRequired[float | None]


class Using(TypedDict):
    """`POST /api/v1/vehicles/{id}/calibrations`: correct the vehicle's samples by this from now on."""

    calibration: str


class Vehicle(TypedDict):
    """One of `GET /api/v1/vehicles`."""

    armed: NotRequired[bool | None]
    boot_id: NotRequired[int]
    connected: NotRequired[bool]
    ground: NotRequired[AtGround | None]
    id: NotRequired[str]
    mode: NotRequired[str | None]
    rig: NotRequired[str]
    vehicle: NotRequired[str]
    version: NotRequired[str]


class Which(TypedDict):
    """`POST gains/revert`, and `GET gains/export?revision=N`."""

    revision: NotRequired[int | None]


class Account(TypedDict):
    """One account."""

    name: str
    role: Role
    two_steps: NotRequired[bool]


class AccountChange(TypedDict):
    """`PATCH /api/v1/people/{name}`."""

    password: NotRequired[str | None]
    role: NotRequired[Role | None]
    two_steps: NotRequired[bool | None]


class AttackPlan(TypedDict):
    """`PUT attacks`: a schedule."""

    attacks: list[PlannedAttack]


class AttackQuestion(TypedDict):
    """An attack to be prepared, or one to be judged before it flies (`POST /api/v1/envelope/attack`)."""

    accel_mps2: NotRequired[float | None]
    attacks: NotRequired[list[PlannedAttack]]
    deviation: NotRequired[str | None]
    generator: NotRequired[str | None]
    of: NotRequired[EnvelopeQuestion]
    start_s: NotRequired[float]
    watermark_mps2: NotRequired[float | None]


class Condition(TypedDict):
    """The flights of one condition."""

    detected: NotRequired[Part | None]
    differences: NotRequired[list[Difference | None]]
    expected: NotRequired[Expectation | None]
    flights: NotRequired[int]
    levels: NotRequired[list[str]]
    lost: NotRequired[dict[str, int]]
    measures: NotRequired[list[Spread | None]]
    number: NotRequired[int]
    tick_us: NotRequired[list[float] | None]


class Controller(TypedDict):
    """One controller that can be chosen."""

    controller: NotRequired[str]
    input_weight: NotRequired[list[float] | None]
    parameters: NotRequired[list[Parameter]]
    state_weight: NotRequired[list[float] | None]
    weighted: NotRequired[bool]


class Controllers(TypedDict):
    """The answer of `GET /api/v1/design/controllers`."""

    airframe: NotRequired[str]
    controllers: NotRequired[list[Controller]]


class EnvelopeCertificate(TypedDict):
    """Why no silent attack goes further: cᵀa ≤ Σ |λᵢ| lᵢ + Σⱼ |c − Σ λᵢ mᵢ|ⱼ uⱼ for any λ, and these are some."""

    added_m: NotRequired[float]
    multipliers: NotRequired[list[EnvelopeMultiplier]]
    regime: NotRequired[str]


class EnvelopeSet(TypedDict):
    """The bound of one set of attacked sensors, from a flight without the attack."""

    altitude_m: NotRequired[float | None]
    attack: NotRequired[list[EnvelopeSequence]]
    binding: NotRequired[str | None]
    certificate: NotRequired[EnvelopeCertificate | None]
    climb_mps: NotRequired[float | None]
    drift_mps: NotRequired[float | None]
    position_m: NotRequired[float | None]
    reached: NotRequired[float | None]
    reached_m: NotRequired[float | None]
    sensors: NotRequired[list[str]]
    tilt_rad: NotRequired[float | None]
    took_ms: NotRequired[float]
    velocity_mps: NotRequired[float | None]


class Examined(TypedDict):
    """
    Poles and margins of one loop. Continuous poles are those of the design (no lag, no delay); the rest has the motors'
    lag and one tick of delay in it.
    """

    continuous_poles_per_s: NotRequired[list[list[float | None]]]
    margins: NotRequired[list[Margin]]
    peak_sensitivity: NotRequired[float | None]
    sampled_poles: NotRequired[list[list[float | None]]]
    slowest_pole_per_s: NotRequired[float | None]


class Experiments(TypedDict):
    """`GET /api/v1/experiments`, newest first."""

    experiments: NotRequired[list[State]]
    total: NotRequired[int]


class FlownAttack(PlannedAttack):
    """One attack of a flight; `start_s` counts from the start of the flight."""

    phase: NotRequired[str]


class Gains(TypedDict):
    """`GET /api/v1/vehicles/{id}/gains`: those in use, absent until the agent has reported them, and every push."""

    certificate: NotRequired[dict[str, Any] | None]
    controller: NotRequired[str | None]
    input_weight: NotRequired[list[float] | None]
    k: NotRequired[Matrix | None]
    parameters: NotRequired[dict[str, float]]
    revision: NotRequired[int | None]
    revisions: NotRequired[list[Revision]]
    sha256: NotRequired[str | None]
    slowest_pole_per_s: NotRequired[float | None]
    state_weight: NotRequired[list[float] | None]


class Ground(TypedDict):
    """`GET /api/v1/ground`."""

    address: NotRequired[str]
    data_folder: NotRequired[str]
    fleet: NotRequired[Fleet | None]
    handshakes_broken_off: NotRequired[int]
    identity_error: NotRequired[str | None]
    recording_error: NotRequired[str | None]
    refused_peers: NotRequired[int]
    schema: NotRequired[int]
    set_aside: NotRequired[list[str]]
    storage: NotRequired[Storage]
    uptime_s: NotRequired[float]
    version: NotRequired[str]


class NewAccount(TypedDict):
    """`POST /api/v1/people`."""

    name: str
    password: str
    role: Role


class NextByHand(TypedDict):
    """What an operator is led through."""

    attacks: NotRequired[list[PlannedAttack]]
    estimator: NotRequired[str]
    flights: NotRequired[int]
    gains: NotRequired[int | None]
    index: NotRequired[int]
    lacks: NotRequired[str]
    lasts_s: NotRequired[float]
    levels: NotRequired[list[str]]
    path: NotRequired[Trajectory]
    place: NotRequired[int]
    rest_left_s: NotRequired[float]
    vehicle: NotRequired[str]


class People(TypedDict):
    """`GET /api/v1/people`, and `GET /api/v1/sessions` without accounts."""

    accounts: NotRequired[list[Account]]
    sessions: NotRequired[list[SignedIn]]


class Picture(TypedDict):
    """One plot of a fit."""

    log: NotRequired[bool]
    series: NotRequired[list[Series]]
    title: NotRequired[str]
    x: NotRequired[str]
    y: NotRequired[str]


class Preview(TypedDict):
    """
    The answer of `POST /api/v1/design/preview`. A design that cannot be solved is refused; one whose margins do not
    suffice is answered, with `accepted` false.
    """

    accepted: NotRequired[bool]
    airframe: NotRequired[str]
    attitude: NotRequired[Examined]
    change: NotRequired[Change | None]
    controller: NotRequired[str]
    gains: NotRequired[dict[str, Any] | None]
    k: NotRequired[list[list[float]] | None]
    k_in_use: NotRequired[list[list[float]] | None]
    parameters: NotRequired[list[Parameter]]
    policy: NotRequired[Policy]
    position: NotRequired[Examined]
    refusal: NotRequired[str | None]
    steps: NotRequired[list[Flown]]
    tick_rate_hz: NotRequired[float]
    unit_step: NotRequired[list[Share]]


class Question(Design):
    """`POST /api/v1/design/preview`: a design, and the steps to fly under it, in one object."""

    duration_s: NotRequired[float | None]
    step: Steps


class Results(TypedDict):
    """What is there of an experiment, condition by condition."""

    conditions: NotRequired[list[Condition]]
    factors: NotRequired[list[str]]
    measures: NotRequired[list[Measure]]
    notes: NotRequired[list[str]]
    state: NotRequired[State]


class ByHand(TypedDict):
    """An experiment that an operator flies."""

    next: NotRequired[NextByHand | None]
    said: NotRequired[list[FlownByHand]]


class Calibration(TypedDict):
    """A calibration: the agent's file, with the name it is kept under. An agent reads it as it is."""

    covariance: NotRequired[list[list[float]] | None]
    date: NotRequired[str]
    id: NotRequired[str]
    input: NotRequired[str]
    kind: NotRequired[str]
    notes: NotRequired[list[str]]
    parameters: NotRequired[list[CalibratedParameter]]
    picture: NotRequired[list[Picture]]
    residual: NotRequired[Residual]
    samples: NotRequired[int]
    schema: NotRequired[int]
    sensor: NotRequired[int | None]
    span_s: NotRequired[list[float] | None]


class Calibrations(TypedDict):
    """`GET /api/v1/calibrations`."""

    calibrations: NotRequired[list[Calibration]]
    total: NotRequired[int]


class Envelope(TypedDict):
    """The bounds of all sets asked for."""

    airframe: NotRequired[str]
    horizon_s: NotRequired[float]
    sets: NotRequired[list[EnvelopeSet]]
    suite: NotRequired[str]


class Flight(TypedDict):
    """One flight: one field for each key of the answer, hence so many."""

    agent_version: NotRequired[str]
    airframe: NotRequired[str]
    attacks: NotRequired[list[FlownAttack]]
    away: NotRequired[bool]
    boot_id: NotRequired[int]
    completeness: NotRequired[Completeness]
    counts: NotRequired[dict[str, int]]
    deleted_unix_us: NotRequired[int | None]
    duration_s: NotRequired[float]
    filled: NotRequired[int]
    first_sequence: NotRequired[int | None]
    ground: NotRequired[str | None]
    id: NotRequired[str]
    last_sequence: NotRequired[int | None]
    live: NotRequired[int]
    messages: NotRequired[int]
    missing: NotRequired[int]
    name: NotRequired[str]
    notes: NotRequired[str]
    outline: NotRequired[Outline | None]
    rig: NotRequired[str]
    seed: NotRequired[int]
    size_bytes: NotRequired[int]
    started_unix_us: NotRequired[int]
    steps: NotRequired[list[Step]]
    tracking_rms_m: NotRequired[float | None]
    vehicle: NotRequired[str]
    vehicle_id: NotRequired[str]


class Flights(TypedDict):
    """`GET /api/v1/flights`."""

    flights: NotRequired[list[Flight]]
    ready: NotRequired[bool]
    storage: NotRequired[Storage]
    total: NotRequired[int]
