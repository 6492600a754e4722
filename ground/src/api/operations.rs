//! What every route of the table is for, is asked and answers, in the order of that table; a test holds both together.

use plumbline_rest::calibration::{Calibration, Calibrations, Fit, Taken, Taking, Using};
use plumbline_rest::command::{
    Answer, AttackPlan, Decoder, Estimator, Mode, Recording, Replay, Setpoint, Simulator, Trajectory, Which,
};
use plumbline_rest::design::{Controllers, Design, Gains, Preview, Question};
use plumbline_rest::envelope::{AttackQuestion, Envelope, EnvelopeQuestion, PreparedAttack};
use plumbline_rest::experiment::{self, Asked, Opened, Results, Size};
use plumbline_rest::flight::{Due, Figures, Flight, Flights, Imported, Labels, Samples, Signals, Spectrum};
use plumbline_rest::ground::{Ground, Lease, Vehicle};
use plumbline_rest::people::{
    AccountChange, Code, Confirmation, Credentials, LiveAddress, NewAccount, NewAuthenticator, People, Session,
};

use super::openapi::{BYTES, Operation, Parameter, list, object, of};

const fn get(path: &'static str, summary: &'static str) -> Operation {
    Operation::new("get", path, summary)
}
const fn post(path: &'static str, summary: &'static str) -> Operation {
    Operation::new("post", path, summary)
}
const fn put(path: &'static str, summary: &'static str) -> Operation {
    Operation::new("put", path, summary)
}
const fn patch(path: &'static str, summary: &'static str) -> Operation {
    Operation::new("patch", path, summary)
}
const fn delete(path: &'static str, summary: &'static str) -> Operation {
    Operation::new("delete", path, summary)
}

/// A command that may be refused by the vehicle.
const fn command(operation: Operation) -> Operation {
    operation.json(of::<Answer>)
}

const HTML: &str = "text/html; charset=utf-8";
const TEXT: &str = "text/plain; charset=utf-8";
const PARQUET: &str = "application/vnd.apache.parquet";
const CSV: &str = "text/csv; charset=utf-8";

const LISTING: &[Parameter] = &[
    ("search", "string", "Words that must all be found in id, name, notes, vehicle, rig, state or attacks."),
    ("vehicle", "string", "Of this vehicle only, by its id."),
    ("from_unix_us", "integer", "Begun then or later, µs since the Unix epoch."),
    ("to_unix_us", "integer", "Begun earlier than that."),
    ("sort", "column", "By which column."),
    ("descending", "boolean", "The largest, or newest, first: so where nothing is said."),
    OFFSET,
    ("limit", "integer", "Most that are answered: 1 to 1000, 100 where nothing is said."),
];
const OFFSET: Parameter = ("offset", "integer", "So many are passed over.");
const SEARCH: Parameter = ("search", "string", "Words that must all be found in it.");
const PAGE: &[Parameter] =
    &[SEARCH, OFFSET, ("limit", "integer", "Most that are answered: 1 to 1000, 1000 where nothing is said.")];
const DOTS: &[Parameter] = &[
    ("from", "integer", "So many are passed over."),
    ("count", "integer", "Most that are answered, 1000 at most."),
    ("condition", "integer", "Of one condition only."),
];
const AROUND: &[Parameter] = &[
    ("vehicle", "string", "Its airframe, tick rate, policy and gains in use stand in for what is left out."),
    ("airframe", "string", "An airframe by name."),
];

const TABLE: &[Parameter] = &[
    FROM,
    TO,
    COLUMNS,
    RATE,
    ("topic", "string", "Every message of one topic instead of the table, without the others."),
];
const RANGE: &[Parameter] = &[FROM, TO, COLUMNS, RATE];
const SIGNAL: Parameter = ("name", "string!", "As it is listed: imu_1.gyro_radps.x.");
/// Of samples.
const STRETCHES: Parameter =
    ("columns", "integer", "Stretches of time, 1 to 10000, 1000 where nothing is said; fewer samples are all told.");
const SINCE_BOOT: [Parameter; 2] =
    [("from_s", "number", "Flight time, s: since the vehicle's boot."), ("to_s", "number", "Flight time, s.")];
const FROM: Parameter = ("from_s", "number", "Since the start of the flight, s.");
const TO: Parameter = ("to_s", "number", "Since the start of the flight, s.");
const COLUMNS: Parameter = (
    "columns",
    "string",
    "Names with commas between them, or their beginnings up to a dot: control,height_2.sensed_m,residuals_9.height_2,secure,events. \
     Residuals are there where they are named.",
);
const RATE: Parameter =
    ("rate_hz", "number", "At most so many rows a second, 100 where nothing is said; 0 for every tick.");

/// Every operation.
pub(super) const OPERATIONS: &[Operation] = &[
    get("/healthz", "The ground runs").media(TEXT),
    get("/readyz", "The ground can record: its index is in line with its files, and the disk takes what comes")
        .media(TEXT),
    get("/metrics", "Figures of link, recorder, queues and disk, for Prometheus").media(TEXT),
    get("/login", "The form to sign in with").media(HTML),
    post("/login", "Signs in by that form").empty(303),
    post("/logout", "Signs out by its form").empty(303),
    get("/api/v1/openapi.json", "This description").json(object),
    get("/api/v1/docs", "This description, for people").media(HTML),
    get("/api/v1/session", "Who asks").json(of::<Session>),
    post("/api/v1/session", "Signs in").takes(of::<Credentials>).json(of::<Session>),
    delete("/api/v1/session", "Signs out").empty(204),
    post("/api/v1/session/authenticator", "A new authenticator, which counts once it is confirmed")
        .json(of::<NewAuthenticator>),
    put("/api/v1/session/authenticator", "From now on this account signs in by two steps")
        .takes(of::<Confirmation>)
        .empty(204),
    delete("/api/v1/session/authenticator", "From now on the password is enough").takes(of::<Code>).empty(204),
    get("/api/v1/sessions", "One's own sessions").json(of::<People>),
    delete("/api/v1/sessions/{id}", "Ends a session").empty(204),
    get("/api/v1/people", "Accounts and sessions").json(of::<People>),
    post("/api/v1/people", "Makes an account").takes(of::<NewAccount>).empty(201),
    patch("/api/v1/people/{id}", "Changes an account").takes(of::<AccountChange>).empty(204),
    delete("/api/v1/people/{id}", "Removes an account").empty(204),
    get("/api/v1/audit", "The last deeds, oldest first")
        .query(&[
            SEARCH,
            ("offset", "integer", "So many of the last are passed over."),
            ("limit", "integer", "Most that are answered: 1 to 1000, 200 where nothing is said."),
        ])
        .json(object),
    post("/api/v1/pairing", "Expects the agent that shows this code").takes(of::<Code>).empty(202),
    get("/api/v1/ground", "What this ground is and how it fares").json(of::<Ground>),
    get("/api/v1/vehicles", "Every vehicle seen").json(list::<Vehicle>),
    get("/api/v1/vehicles/{id}/live", "A WebSocket of batches, the newest of every topic first")
        .query(&[
            ("history", "number", "Begin so many seconds back."),
            ("thinned", "boolean", "Only what a page shows: 40 estimates a second, of residuals the worst of each eighth."),
            ("operator", "string", "What the page calls itself."),
        ])
        .empty(101),
    get(
        "/api/v1/vehicles/{id}/foxglove",
        "The Foxglove WebSocket protocol: every topic, a scene, gains and limits, services for mode, setpoint and cut",
    )
    .query(&[
        ("operator", "string", "What a client calls itself, where nobody signs in."),
        ("ticket", "string", "Instead of a session: as `POST` has answered it, once and within minutes."),
    ])
    .empty(101),
    post(
        "/api/v1/vehicles/{id}/foxglove",
        "An address of that link for a program that cannot sign in: it opens once, within minutes, for whoever asks and while their session lasts",
    )
    .json(of::<LiveAddress>),
    get("/api/v1/vehicles/{id}/history", "The past as one batch, thinned for charts")
        .query(&[("seconds", "integer!", "How far back.")])
        .media(BYTES),
    get("/api/v1/vehicles/{id}/signals", "Every number that a vehicle sends, by topic").json(of::<Signals>),
    get("/api/v1/vehicles/{id}/signal", "One of them over flight time, of the last two minutes at most")
        .query(&[SIGNAL, SINCE_BOOT[0], SINCE_BOOT[1], STRETCHES])
        .json(of::<Samples>),
    get("/api/v1/vehicles/{id}/spectrum", "Its spectrum, of the last two minutes at most")
        .query(&[SIGNAL, SINCE_BOOT[0], SINCE_BOOT[1]])
        .json(of::<Spectrum>),
    command(post(
        "/api/v1/vehicles/{id}/cut",
        "Cuts the motors: the vehicle falls. Open to every operator, whoever holds control",
    )),
    command(post("/api/v1/vehicles/{id}/arm", "Arms")),
    command(post("/api/v1/vehicles/{id}/disarm", "Disarms")),
    command(post("/api/v1/vehicles/{id}/release-cut", "Releases the cut")),
    command(post("/api/v1/vehicles/{id}/mode", "Changes the mode").takes(of::<Mode>)),
    command(post("/api/v1/vehicles/{id}/estimator", "Puts an estimator in the loop").takes(of::<Estimator>)),
    command(post("/api/v1/vehicles/{id}/decoder", "Chooses the secure estimator's decoder").takes(of::<Decoder>)),
    command(post("/api/v1/vehicles/{id}/recording", "Begins or ends a recording").takes(of::<Recording>)),
    command(post("/api/v1/vehicles/{id}/replay", "Speed of a replay").takes(of::<Replay>)),
    command(
        post("/api/v1/vehicles/{id}/simulator", "What only a simulated vehicle can be given").takes(of::<Simulator>),
    ),
    command(post("/api/v1/vehicles/{id}/setpoint", "Changes the setpoint; absent fields stay").takes(of::<Setpoint>)),
    command(put("/api/v1/vehicles/{id}/attacks", "Uploads a schedule of attacks whole").takes(of::<AttackPlan>)),
    command(delete("/api/v1/vehicles/{id}/attacks", "Aborts what attacks")),
    get("/api/v1/vehicles/{id}/gains", "Gains in use, and every revision").json(of::<Gains>),
    command(put("/api/v1/vehicles/{id}/gains", "Pushes a design; the vehicle examines it").takes(of::<Design>)),
    get("/api/v1/vehicles/{id}/gains/export", "Gains as a file")
        .query(&[("revision", "integer", "An earlier design.")])
        .json(object),
    command(post("/api/v1/vehicles/{id}/gains/revert", "Pushes an earlier design again").takes(of::<Which>)),
    command(
        post("/api/v1/vehicles/{id}/trajectory", "Flies a path from where the setpoint is").takes(of::<Trajectory>),
    ),
    command(delete("/api/v1/vehicles/{id}/trajectory", "Stops it")),
    get("/api/v1/vehicles/{id}/envelope", "How far an attacker who is not seen can push it").json(of::<Envelope>),
    get("/api/v1/vehicles/{id}/calibration", "How far the samples taken by hand are from what a fit asks for")
        .json(of::<Taken>),
    post("/api/v1/vehicles/{id}/calibration", "Takes samples for a calibration while somebody turns the vehicle, disarmed")
        .takes(of::<Taking>)
        .json(of::<Taken>),
    delete("/api/v1/vehicles/{id}/calibration", "Gives them up").empty(204),
    command(
        post("/api/v1/vehicles/{id}/calibrations", "Corrects the samples of an IMU by a kept calibration, disarmed")
            .takes(of::<Using>),
    ),
    command(delete(
        "/api/v1/vehicles/{id}/calibrations/{kind}/{imu}",
        "Stops using the calibration of a kind (accelerometer, gyroscope, magnetometer, thermal) on an IMU, disarmed",
    )),
    get("/api/v1/vehicles/{id}/lease", "Who holds control").json(of::<Lease>),
    put("/api/v1/vehicles/{id}/lease", "Takes control").json(of::<Lease>),
    delete("/api/v1/vehicles/{id}/lease", "Gives control back").json(of::<Lease>),
    post("/api/v1/design/preview", "What a design would do").query(AROUND).takes(of::<Question>).json(of::<Preview>),
    get("/api/v1/design/controllers", "Controllers, with their parameters").query(AROUND).json(of::<Controllers>),
    post("/api/v1/envelope", "How far an attacker who is not seen can push a vehicle")
        .query(&[(
            "vehicle",
            "string",
            "Its sensors, airframe, tick rate and gains in use stand in for what is left out.",
        )])
        .takes(of::<EnvelopeQuestion>)
        .json(of::<Envelope>),
    post("/api/v1/envelope/attack", "Prepares an attack, and tells how surely it is seen")
        .query(&[(
            "vehicle",
            "string",
            "Its sensors, airframe, tick rate and gains in use stand in for what is left out.",
        )])
        .takes(of::<AttackQuestion>)
        .json(of::<PreparedAttack>),
    get("/api/v1/calibrations", "Calibrations kept, a page of them").query(PAGE).json(of::<Calibrations>),
    post("/api/v1/calibrations", "Fits a calibration and keeps it").takes(of::<Fit>).created(of::<Calibration>),
    get("/api/v1/calibrations/{id}", "A calibration, whole").json(of::<Calibration>),
    get("/api/v1/experiments", "Experiments that are kept, a page of them")
        .query(PAGE)
        .json(of::<experiment::Experiments>),
    post("/api/v1/experiments", "Keeps a plan and starts flying it")
        .takes(of::<Asked>)
        .created(of::<experiment::State>),
    post("/api/v1/experiments/size", "What a plan comes to; nothing is kept").takes(of::<Asked>).json(of::<Size>),
    get("/api/v1/experiments/{id}", "What is there of an experiment, condition by condition").json(of::<Results>),
    post("/api/v1/experiments/{id}/start", "Flies what is not there yet").json(of::<experiment::State>),
    post("/api/v1/experiments/{id}/stop", "Stops after the flights in the air").json(of::<experiment::State>),
    get("/api/v1/experiments/{id}/flights", "Its flights, a page of them").query(DOTS).json(of::<experiment::Flights>),
    post("/api/v1/experiments/{id}/flights/{index}", "Flies one again and records it").json(of::<Opened>),
    get("/api/v1/experiments/{id}/flights/{index}/open", "The same, then to the page of that flight").empty(303),
    get("/api/v1/experiments/{id}/by-hand", "The next flight of an operator, and what was said of those before")
        .json(of::<experiment::ByHand>),
    post("/api/v1/experiments/{id}/by-hand", "Accepts a flight, which is judged then, or says why it is void")
        .takes(of::<experiment::Said>)
        .json(of::<experiment::ByHand>),
    get("/api/v1/experiments/{id}/plan.toml", "Its plan").media("application/toml"),
    get("/api/v1/experiments/{id}/report.html", "Its report, self-contained").media(HTML),
    get("/api/v1/experiments/{id}/flights.parquet", "A row for each flight").media(PARQUET).tagged(),
    get("/api/v1/experiments/{id}/against/{second}", "What a second experiment differs from it in, self-contained")
        .media(HTML),
    get("/api/v1/archive", "Files of many flights as one tar, with their hashes: unpacked, it is a backup folder")
        .query(&[
            ("ids", "string!", "Ids of flights with commas between them, 500 at most."),
            (
                "format",
                "format",
                "mcap where nothing is said: no backup is what csv, parquet, mat, ros2 or foxglove give.",
            ),
        ])
        .media("application/x-tar")
        .tagged(),
    get("/api/v1/archive/due", "Flights that retention will delete, the oldest first").json(list::<Due>),
    get("/api/v1/flights", "Flights, a page of them").query(LISTING).json(of::<Flights>),
    post("/api/v1/flights", "Takes in a recording: a flight of Plumbline, or of PX4, BROAD, RotorPy or a Phantom 4, flown through every estimator")
        .form()
        .created(of::<Imported>)
        .known(),
    get("/api/v1/flights/{id}", "A flight").json(of::<Flight>),
    patch("/api/v1/flights/{id}", "Names and annotates a flight").takes(of::<Labels>).json(of::<Flight>),
    delete("/api/v1/flights/{id}", "Deletes a flight").empty(204),
    get("/api/v1/flights/{id}/mcap", "Its file; ranges are served").media(BYTES).ranged(),
    get("/api/v1/flights/{id}/csv", "Its samples as a table").query(TABLE).media(CSV).tagged(),
    get("/api/v1/flights/{id}/parquet", "The same, typed and compressed; units in the metadata")
        .query(RANGE)
        .media(PARQUET)
        .tagged(),
    get("/api/v1/flights/{id}/mat", "The same for MATLAB: data, names, units, event_time_s, event_text")
        .query(RANGE)
        .media("application/x-matlab-data")
        .tagged(),
    get("/api/v1/flights/{id}/ros2", "A ROS 2 bag: MCAP, CDR, messages of sensor_msgs, nav_msgs and geometry_msgs")
        .query(&[FROM, TO])
        .media(BYTES)
        .tagged(),
    get(
        "/api/v1/flights/{id}/foxglove",
        "Its messages, and beside them /tf, /scene and /log in Foxglove's schemas: MCAP",
    )
    .query(&[FROM, TO])
    .media(BYTES)
    .tagged(),
    get("/api/v1/flights/{id}/frames", "Its messages as batches")
        .query(&[
            ("kinds", "string", "Kinds with commas between them, all where nothing is said."),
            FROM,
            TO,
            (
                "columns",
                "integer",
                "1 to 10000: no longer every message, but what charts so many columns wide show of them.",
            ),
        ])
        .media(BYTES)
        .tagged(),
    get("/api/v1/flights/{id}/estimate", "Estimates the recording again")
        .query(&[("estimator", "estimator!", "Which."), ("sensors", "string", "Which samples it is given, with commas.")])
        .json(object),
    get("/api/v1/flights/{id}/signals", "Every number that was recorded, by topic").json(of::<Signals>),
    get("/api/v1/flights/{id}/signal", "One of them over time, thinned to the least and the greatest of each stretch")
        .query(&[
            SIGNAL,
            FROM,
            TO,
            STRETCHES,
        ])
        .json(of::<Samples>),
    get("/api/v1/flights/{id}/spectrum", "Its power over frequency, by Welch's method")
        .query(&[SIGNAL, FROM, TO])
        .json(of::<Spectrum>),
    get("/api/v1/flights/{id}/figures", "Errors of its estimators, effects of its attacks, from every message")
        .json(of::<Figures>),
];
