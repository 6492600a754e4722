"""Bodies of the HTTP API, made by `make_models.py` from its description: not edited by hand."""

from __future__ import annotations

from typing import Any, Literal, TypeAlias, TypedDict

from typing_extensions import NotRequired


class Aim(TypedDict):
    """Something that a fit counts."""

    best: int
    found: int
    needed: int
    what: str


class Answer(TypedDict):
    """The answer to a command that the vehicle accepted; one that it rejected is a [`crate::Problem`] of status 409."""

    command_id: int
    reason: str
    revision: NotRequired[int | None]
    stage: str


class Asked(TypedDict):
    """A plan, TOML."""

    plan: str


class AtGround(TypedDict):
    """Another ground."""

    address: str
    name: str


class AttackEffect(TypedDict):
    """What an attack did."""

    accepted_time_us: int
    deviation_m: list[float] | None
    excluded: list[list[int]]
    id: int
    isolated_after_s: float | None
    rejected_after_s: float | None
    rms_before_m: float | None


class CalibratedParameter(TypedDict):
    """One fitted number."""

    name: str
    sigma: float | None
    unit: str
    value: float


class Change(TypedDict):
    """‖ΔK‖/‖K‖ against the gains in use."""

    largest: float | None
    row: str | None
    rows: dict[str, float | None]


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

    decoder: Literal['l2', 'l1', 'l2_split', 'l1_split']


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

    baseline: int
    effect: float | None
    interval: list[float] | None
    median: float
    pairs: int


class Due(TypedDict):
    """One of `GET /api/v1/archive/due`: a flight that retention will delete."""

    bytes: int
    deleted_unix_us: int | None
    id: str
    why: str


class EnvelopeMultiplier(TypedDict):
    """A detector at one time, and its multiplier."""

    detector: str
    limit: float
    multiplier: float
    row: list[float]
    sensor: NotRequired[str | None]
    statistics: int
    time_s: float


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

    period_s: float
    sensor: str
    values: list[float]


class Estimator(TypedDict):
    """`POST estimator`: which is in the loop."""

    estimator: Literal['ekf_bias', 'complementary', 'ekf_hybrid', 'ukf', 'constant_acceleration', 'vqf', 'secure', 'attitude_ekf', 'lanes']


class Expectation(TypedDict):
    """
    What the model of the lanes expects of an attack on one sensor, by the flights of the condition as planned. Of several sensors it
    says nothing: the model has any of them excluded, [`Condition::detected`] all.
    """

    differs: bool
    note: str
    probability: float | None


class ExperimentFlight(TypedDict):
    """One flight."""

    condition: int
    index: int
    lost: str
    seed: int
    values: list[float | None]


class ExperimentFlights(TypedDict):
    """Flights of an experiment, some of them."""

    flights: list[ExperimentFlight]
    total: int


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

    archive: str | None
    archive_error: str | None
    grounds: list[str] | None
    index: str | None
    live_error: str | None
    name: str
    waiting: int


class Flown(TypedDict):
    """A step flown on the nonlinear vehicle; curves are columns of equal length."""

    largest_command: list[float | None]
    output: str
    overshoot_percent: float | None
    response: list[float | None]
    rise_time_s: float | None
    saturated_s: float | None
    setpoint: list[float | None]
    settling_time_s: float | None
    size: float
    stayed: bool | None
    t_s: list[float | None]
    unit: str


class FlownAttack(TypedDict):
    """One attack of a flight; `start_s` counts from the start of the flight."""

    channel: Literal['all', 'gyro', 'accel', 'mag', 'x', 'y', 'z', 'gyro_x', 'gyro_y', 'gyro_z', 'accel_x', 'accel_y', 'accel_z']
    duration_s: float
    instance: int
    kind: Literal['zero', 'bias', 'ramp', 'scale', 'noise', 'freeze', 'replay', 'delay', 'dropout', 'sign_flip', 'parabola', 'time_shift']
    magnitude: float
    phase: str
    seed: int
    sensor: Literal['imu', 'height', 'barometer', 'gnss', 'mocap_pose', 'camera_ranges', 'rotor']
    sequence: NotRequired[list[float]]
    sequence_period_s: NotRequired[float | None]
    start_s: float


class FlownByHand(TypedDict):
    """What was said of a flight, and by whom."""

    accepted: bool
    flight: str
    index: int
    reason: str
    unix_us: int
    who: str


class Followed(TypedDict):
    """How an autopilot took over what it was asked for, rad/s or 0..1."""

    asked_rms: float | None
    off: list[float] | None


class Imported(TypedDict):
    """`POST /api/v1/flights`: a recording from elsewhere is a flight now."""

    already: bool
    flight: str
    notes: list[str]


class Labels(TypedDict):
    """`PATCH /api/v1/flights/{id}`; what is absent stays."""

    name: NotRequired[str | None]
    notes: NotRequired[str | None]


class Lease(TypedDict):
    """Who holds control of a vehicle."""

    holder: str | None
    taken_from: NotRequired[str | None]


class LiveAddress(TypedDict):
    """`POST /api/v1/vehicles/{id}/foxglove`: where a program that cannot sign in sees a vehicle live."""

    url: str
    valid_s: int | None


class Margin(TypedDict):
    """Margins of one input."""

    crossover_radps: float | None
    delay_s: float | None
    gain_down: float | None
    gain_up: float | None
    input: str
    peak_sensitivity: float | None
    phase_rad: float | None


class Matrix(TypedDict):
    """A matrix, row by row."""

    columns: int
    rows: int
    values: list[float]


class Measure(TypedDict):
    """A column of numbers."""

    about: str
    name: str


class Mode(TypedDict):
    """`POST mode`."""

    mode: Literal['stabilise', 'altitude_hold', 'hold', 'land']


class NewAuthenticator(TypedDict):
    """`POST /api/v1/session/authenticator`: a new one, which counts once a code of it has come back."""

    secret: str
    svg: str
    url: str


class Opened(TypedDict):
    """A flight of an experiment, recorded."""

    flight: str


class Outline(TypedDict):
    """
    The altitude of a flight, for a picture of some hundred pixels: true where truth is recorded, else as estimated in the
    loop.
    """

    altitude_cm: list[list[int] | None]
    from_s: float
    step_s: float


class Parameter(TypedDict):
    """A parameter and what it may be."""

    max: float
    min: float
    name: str
    unit: str
    value: float


class Part(TypedDict):
    """So many of so many."""

    count: int
    interval: list[float]
    of: int


class PlannedAttack(TypedDict):
    """One attack."""

    channel: NotRequired[Literal['all', 'gyro', 'accel', 'mag', 'x', 'y', 'z', 'gyro_x', 'gyro_y', 'gyro_z', 'accel_x', 'accel_y', 'accel_z']]
    duration_s: float
    instance: int
    kind: Literal['zero', 'bias', 'ramp', 'scale', 'noise', 'freeze', 'replay', 'delay', 'dropout', 'sign_flip', 'parabola', 'time_shift']
    magnitude: NotRequired[float]
    seed: NotRequired[int]
    sensor: Literal['imu', 'height', 'barometer', 'gnss', 'mocap_pose', 'camera_ranges', 'rotor']
    sequence: NotRequired[list[float]]
    sequence_period_s: NotRequired[float | None]
    start_s: float


class Policy(TypedDict):
    """What the vehicle's loops must forgive."""

    change_max: float
    delay_min_s: float
    gain_down_max: float
    gain_up_min: float
    name: str
    phase_min_rad: float
    sensitivity_max: float
    slowest_pole_per_s: float
    unit_step_max: float


class PreparedAttack(TypedDict):
    """An attack, and what is expected of it with lanes in the loop."""

    altitude_m: NotRequired[float | None]
    attacks: list[PlannedAttack]
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

    code: str
    command_id: NotRequired[int | None]
    detail: str
    holder: NotRequired[str | None]
    revision: NotRequired[int | None]
    status: int
    title: str
    type: str


class Recording(TypedDict):
    """`POST recording`."""

    on: bool


class Replay(TypedDict):
    """`POST replay`."""

    speed: float
    step: NotRequired[int]


class Residual(TypedDict):
    """What the model leaves."""

    unit: str
    value: float | None


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

    samples: int
    time_s: list[float]
    value: list[float]


class Series(TypedDict):
    """Points of one kind in a plot."""

    line: bool
    name: str
    points: list[list[float | None]]


class Session(TypedDict):
    """`GET /api/v1/session`: who asks."""

    name: str | None
    role: Role | None
    sign_in_needed: bool
    signed_in: bool
    two_steps: bool


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

    output: str
    share: float | None
    unit: str


class Signal(TypedDict):
    """One number of one topic."""

    name: str
    unit: str


class Signals(TypedDict):
    """`GET /api/v1/flights/{id}/signals`, `GET /api/v1/vehicles/{id}/signals`."""

    signals: list[Signal]
    start_s: float


SignedIn = TypedDict(
    'SignedIn',
    {
        'account': str,
        'begun_s': int,
        'from': str,
        'id': str,
        'seen_s': int,
    },
)


class Simulator(TypedDict):
    """`POST simulator`: what only a simulated vehicle can be given."""

    battery: NotRequired[bool]
    reset: NotRequired[bool]


class Size(TypedDict):
    """What a plan comes to."""

    by_hand: bool
    conditions: int
    done: int
    expected_s: float
    flights: int
    id: str
    repeats: int


class Spectrum(TypedDict):
    """`GET /api/v1/flights/{id}/spectrum`, `GET /api/v1/vehicles/{id}/spectrum`: Welch's method, Hann windows that overlap by half, one-sided."""

    density: list[float]
    frequency_hz: list[float]
    harmonics_hz: list[float]
    mean: float
    rate_hz: float
    rms: float
    rotor_hz: float | None
    windows: int


class Spread(TypedDict):
    """Values of many flights."""

    count: int
    interval: list[float] | None
    least: float
    median: float
    most: float
    of_95: float
    quarter: float
    three_quarters: float


class State(TypedDict):
    """How an experiment stands."""

    by_hand: bool
    description: str
    done: int
    error: str | None
    flights: int
    id: str
    left_s: float | None
    made_unix_us: int
    name: str
    own: bool
    per_s: float | None
    running: bool


class Step(TypedDict):
    """One setpoint step of a flight."""

    from_m: float
    interrupted: bool
    overshoot_percent: float
    rise_time_s: float | None
    settling_time_s: float | None
    start_s: float
    steady_error_m: float | None
    to_m: float


class Steps(TypedDict):
    """Sizes of the steps."""

    x_m: NotRequired[float | None]
    y_m: NotRequired[float | None]
    yaw_rad: NotRequired[float | None]
    z_m: NotRequired[float | None]


class Storage(TypedDict):
    """What the recordings take and leave."""

    flights: int
    free_bytes: int
    used_bytes: int


class Taken(TypedDict):
    """
    `GET /api/v1/vehicles/{id}/calibration`: samples taken so far, and what the fit asks for, counted by the fit's own code. Directions
    are unit vectors in the body frame FLU.
    """

    aims: list[Aim]
    bands: int
    field: list[float] | None
    imu: int
    kind: str
    poses: list[list[float]]
    problem: str
    ready: bool
    samples: int
    sectors: list[bool]
    span_s: float
    still: float
    undetermined: str
    up: list[float] | None


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
    shape: Literal['circle', 'sine', 'square', 'heave', 'altitudes']
    size_m: NotRequired[float | None]
    speed_mps: NotRequired[float | None]


class Using(TypedDict):
    """`POST /api/v1/vehicles/{id}/calibrations`: correct the vehicle's samples by this from now on."""

    calibration: str


class Vehicle(TypedDict):
    """One of `GET /api/v1/vehicles`."""

    armed: bool | None
    boot_id: int
    connected: bool
    ground: NotRequired[AtGround | None]
    id: str
    mode: str | None
    rig: str
    vehicle: str
    version: str


class Which(TypedDict):
    """`POST gains/revert`, and `GET gains/export?revision=N`."""

    revision: NotRequired[int | None]


class Account(TypedDict):
    """One account."""

    name: str
    role: Role
    two_steps: bool


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

    detected: Part | None
    differences: list[Difference | None]
    expected: Expectation | None
    flights: int
    levels: list[str]
    lost: dict[str, int]
    measures: list[Spread | None]
    number: int
    tick_us: list[float] | None


class Controller(TypedDict):
    """One controller that can be chosen."""

    controller: str
    input_weight: list[float] | None
    parameters: list[Parameter]
    state_weight: list[float] | None
    weighted: bool


class Controllers(TypedDict):
    """The answer of `GET /api/v1/design/controllers`."""

    airframe: str
    controllers: list[Controller]


class EnvelopeCertificate(TypedDict):
    """Why no silent attack goes further: cᵀa ≤ Σ |λᵢ| lᵢ + Σⱼ |c − Σ λᵢ mᵢ|ⱼ uⱼ for any λ, and these are some."""

    added_m: float
    end_s: float
    most: list[float]
    multipliers: list[EnvelopeMultiplier]
    objective: list[float]
    regime: str


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
    sensors: list[str]
    tilt_rad: NotRequired[float | None]
    took_ms: float
    velocity_mps: NotRequired[float | None]


class EstimatorError(TypedDict):
    """What an estimator was off by, from its first estimate on."""

    altitude_error_mm: Samples
    altitude_mm: list[float] | None
    attitude_mrad: list[float] | None
    estimator: int


class Examined(TypedDict):
    """
    Poles and margins of one loop. Continuous poles are those of the design (no lag, no delay); the rest has the motors'
    lag and one tick of delay in it.
    """

    continuous_poles_per_s: list[list[float | None]]
    margins: list[Margin]
    peak_sensitivity: float | None
    sampled_poles: list[list[float | None]]
    slowest_pole_per_s: float | None


class Experiments(TypedDict):
    """`GET /api/v1/experiments`, newest first."""

    experiments: list[State]
    total: int


class Figures(TypedDict):
    """`GET /api/v1/flights/{id}/figures`."""

    attacks: list[AttackEffect]
    autopilot: list[Followed]
    estimators: list[EstimatorError]
    start_s: float
    truth: bool


class Flight(TypedDict):
    """One flight: one field for each key of the answer, hence so many."""

    agent_version: str
    airframe: str
    attacks: list[FlownAttack]
    away: bool
    boot_id: int
    completeness: Completeness
    counts: dict[str, int]
    deleted_unix_us: int | None
    duration_s: float
    filled: int
    first_sequence: int | None
    ground: str | None
    id: str
    last_sequence: int | None
    live: int
    messages: int
    missing: int
    name: str
    notes: str
    outline: NotRequired[Outline | None]
    rig: str
    seed: int
    size_bytes: int
    started_unix_us: int
    steps: list[Step]
    tracking_rms_m: float | None
    vehicle: str
    vehicle_id: str


class Flights(TypedDict):
    """`GET /api/v1/flights`."""

    flights: list[Flight]
    ready: bool
    storage: Storage
    total: int


class Gains(TypedDict):
    """`GET /api/v1/vehicles/{id}/gains`: those in use, absent until the agent has reported them, and every push."""

    certificate: dict[str, Any] | None
    controller: str | None
    input_weight: list[float] | None
    k: Matrix | None
    parameters: dict[str, float] | None
    revision: int | None
    revisions: list[Revision]
    sha256: str | None
    slowest_pole_per_s: float | None
    state_weight: list[float] | None


class Ground(TypedDict):
    """`GET /api/v1/ground`."""

    address: str
    data_folder: str
    fleet: Fleet | None
    handshakes_broken_off: int
    identity_error: str | None
    recording_error: str | None
    refused_peers: int
    schema: int
    set_aside: list[str]
    storage: Storage
    uptime_s: float
    version: str


class NewAccount(TypedDict):
    """`POST /api/v1/people`."""

    name: str
    password: str
    role: Role


class NextByHand(TypedDict):
    """What an operator is led through."""

    attacks: list[PlannedAttack]
    estimator: str
    flights: int
    gains: int | None
    index: int
    lacks: str
    lasts_s: float
    levels: list[str]
    path: Trajectory
    place: int
    rest_left_s: float
    vehicle: str


class People(TypedDict):
    """`GET /api/v1/people`, and `GET /api/v1/sessions` without accounts."""

    accounts: list[Account]
    sessions: list[SignedIn]


class Picture(TypedDict):
    """One plot of a fit."""

    log: bool
    series: list[Series]
    title: str
    x: str
    y: str


class Preview(TypedDict):
    """
    The answer of `POST /api/v1/design/preview`. A design that cannot be solved is refused; one whose margins do not
    suffice is answered, with `accepted` false.
    """

    accepted: bool
    airframe: str
    attitude: Examined
    change: Change | None
    controller: str
    gains: dict[str, Any] | None
    k: list[list[float]] | None
    k_in_use: list[list[float]] | None
    parameters: list[Parameter]
    policy: Policy
    position: Examined
    refusal: str | None
    steps: list[Flown]
    tick_rate_hz: float
    unit_step: list[Share]


class Question(TypedDict):
    """`POST /api/v1/design/preview`: a design, and the steps to fly under it, in one object."""

    airframe: NotRequired[str | None]
    certificate: NotRequired[dict[str, Any] | None]
    controller: NotRequired[str | None]
    duration_s: NotRequired[float | None]
    format: NotRequired[str | None]
    input_weight: NotRequired[list[float] | None]
    k: NotRequired[list[list[float]] | None]
    k_attitude: NotRequired[list[list[float]] | None]
    parameters: NotRequired[dict[str, float]]
    state_weight: NotRequired[list[float] | None]
    step: Steps
    tick_rate_hz: NotRequired[float | None]
    units: NotRequired[dict[str, Any] | None]


class Results(TypedDict):
    """What is there of an experiment, condition by condition."""

    conditions: list[Condition]
    factors: list[str]
    measures: list[Measure]
    notes: list[str]
    state: State


class ByHand(TypedDict):
    """An experiment that an operator flies."""

    next: NextByHand | None
    said: list[FlownByHand]


class Calibration(TypedDict):
    """A calibration: the agent's file, with the name it is kept under. An agent reads it as it is."""

    covariance: NotRequired[list[list[float]] | None]
    date: str
    id: str
    input: str
    kind: str
    notes: list[str]
    parameters: list[CalibratedParameter]
    picture: NotRequired[list[Picture]]
    residual: Residual
    samples: int
    schema: int
    sensor: int | None
    span_s: list[float] | None


class Calibrations(TypedDict):
    """`GET /api/v1/calibrations`."""

    calibrations: list[Calibration]
    total: int


class Envelope(TypedDict):
    """The bounds of all sets asked for."""

    airframe: str
    horizon_s: float
    sets: list[EnvelopeSet]
    suite: str
