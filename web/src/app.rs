//! The page's state between ground and panels: which ground, which vehicle, which socket, which notices.
//!
//! [`App::update`] is pure: events in, effects out. What flies is in [`Live`]; the runtime that does
//! the effects is `ctx.rs`, the drawing `paint.rs`.

use plumbline_rest::ground::{AtGround, Ground, Vehicle};
use std::collections::VecDeque;

use crate::{
    event::{Effect, Event, Failure, Tone},
    model::live::Live,
};

/// Notices on screen; older ones go first.
const MAX_NOTICES: usize = 5;
/// First wait before a reconnect, ms; doubled up to [`LONGEST_WAIT_MS`].
const FIRST_WAIT_MS: u32 = 250;
/// Longest wait before a reconnect, ms.
const LONGEST_WAIT_MS: u32 = 4000;
/// History asked for first unless the page knows better, s.
pub const HISTORY_S: f64 = 60.0;
/// History asked for in the end; the ground keeps no more, s.
pub const MOST_HISTORY_S: f64 = 120.0;

/// State of the live socket.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Socket {
    /// No vehicle chosen yet.
    #[default]
    Idle,
    /// Opening for the first time, or again.
    Opening,
    /// Open.
    Open,
    /// Lost; waiting to try again.
    Waiting,
}

/// What the page can say of the ground.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum GroundState {
    /// Not asked yet.
    #[default]
    Unknown,
    /// It answers.
    Up(Ground),
    /// It does not, and why.
    Down(String),
}

/// A notice to the operator.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Notice {
    /// Number, from 1.
    pub number: u64,
    /// How loud.
    pub tone: Tone,
    /// Text.
    pub text: String,
}

/// State of the page, apart from what flies.
#[derive(Debug, Default)]
pub struct App {
    /// The ground.
    pub ground: GroundState,
    /// Vehicles known to it; `None` before the first answer.
    pub vehicles: Option<Vec<Vehicle>>,
    /// Vehicle shown.
    pub vehicle: Option<String>,
    /// Vehicle shown before a reload, preferred when it is there.
    pub remembered: Option<String>,
    /// Live socket.
    pub socket: Socket,
    /// Notices.
    pub notices: VecDeque<Notice>,
    /// History to ask for first, s: as long as the charts' window.
    pub history_s: f64,
    /// The ground is being asked for its state.
    asking: bool,
    schema_told: bool,
    wait_ms: u32,
    notice_number: u64,
}

impl App {
    /// A page that showed `remembered` before it was reloaded.
    pub fn new(remembered: Option<String>) -> Self {
        Self { remembered, history_s: HISTORY_S, wait_ms: FIRST_WAIT_MS, ..Self::default() }
    }

    /// The vehicle shown, as the ground lists it.
    pub fn listed(&self) -> Option<&Vehicle> {
        let id = self.vehicle.as_ref()?;
        self.vehicles.as_ref()?.iter().find(|v| v.id == *id)
    }

    /// The vehicles to choose from and whether each is connected: those of the ground, and the one shown where the ground
    /// does not know it. None before the first answer.
    pub fn offered(&self) -> Vec<(String, bool)> {
        let Some(vehicles) = &self.vehicles else { return Vec::new() };
        let unknown = self.vehicle.iter().filter(|_| self.listed().is_none()).map(|id| (id.clone(), false));
        vehicles.iter().map(|v| (v.id.clone(), v.connected)).chain(unknown).collect()
    }

    /// The ground that the vehicle shown is flown from; `None` where that is this one.
    pub fn elsewhere(&self) -> Option<&AtGround> {
        self.listed()?.ground.as_ref()
    }

    /// Takes one event into the state.
    pub fn update(&mut self, live: &mut Live, event: Event) -> Vec<Effect> {
        match event {
            Event::Poll => self.ask().into_iter().collect(),
            Event::Ground(Ok(ground)) => {
                self.ground = GroundState::Up(ground);
                Vec::new()
            }
            Event::Ground(Err(failure)) => {
                self.ground = GroundState::Down(failure.text);
                Vec::new()
            }
            Event::Vehicles(Ok(vehicles)) => {
                self.asking = false;
                self.vehicles = Some(vehicles);
                self.choose_first(live)
            }
            Event::Vehicles(Err(failure)) => {
                self.asking = false;
                if failure.status == 0 {
                    self.ground = GroundState::Down(failure.text);
                }
                Vec::new()
            }
            Event::Choose(id) => self.choose(live, id),
            Event::SocketOpened => {
                self.socket = Socket::Open;
                self.wait_ms = FIRST_WAIT_MS;
                live.connection_opened();
                let history = |s: f64| self.vehicle.clone().map(|id| Effect::FetchHistory(id, s));
                history(self.history_s).into_iter().collect()
            }
            Event::History(id, seconds, past) => {
                if self.vehicle.as_ref() != Some(&id) {
                    return Vec::new();
                }
                live.fill(*past);
                if seconds < MOST_HISTORY_S { vec![Effect::FetchHistory(id, MOST_HISTORY_S)] } else { Vec::new() }
            }
            Event::SocketClosed => {
                self.socket = Socket::Waiting;
                let wait = self.wait_ms;
                self.wait_ms = (wait * 2).min(LONGEST_WAIT_MS);
                vec![Effect::RetryIn(wait)]
            }
            Event::Reconnect => match (self.socket, self.vehicle.clone()) {
                (Socket::Waiting, Some(id)) => {
                    self.socket = Socket::Opening;
                    std::iter::once(Effect::OpenSocket(id)).chain(self.ask()).collect()
                }
                _ => Vec::new(),
            },
            Event::Batch(bytes, local_ms) => self.batch(live, &bytes, local_ms),
            Event::Answered(what, result) => self.answered(&what, result),
            Event::Tell(tone, text) => self.tell(tone, text),
            Event::Dismiss(number) => {
                self.notices.retain(|n| n.number != number);
                Vec::new()
            }
        }
    }

    /// One question at a time: on a network that swallows them, more would take all of the browser's connections.
    fn ask(&mut self) -> Option<Effect> {
        (!std::mem::replace(&mut self.asking, true)).then_some(Effect::FetchState)
    }

    fn choose_first(&mut self, live: &mut Live) -> Vec<Effect> {
        // A vehicle remembered from another day may be unknown to this ground. One that was heard of here is left by choice
        // alone, though a ground that was started again does not know it before it connects.
        let heard = live.boot() != 0 || live.clock.newest_us() > 0;
        let shown = self.vehicle.is_some() && (heard || self.socket == Socket::Open || self.listed().is_some());
        let Some(vehicles) = self.vehicles.as_ref().filter(|_| !shown) else { return Vec::new() };
        let remembered = vehicles.iter().find(|v| Some(&v.id) == self.remembered.as_ref());
        let choice = remembered.or_else(|| vehicles.iter().find(|v| v.connected)).or_else(|| vehicles.first());
        match choice.map(|v| v.id.clone()) {
            Some(id) => self.choose(live, id),
            None => Vec::new(),
        }
    }

    fn choose(&mut self, live: &mut Live, id: String) -> Vec<Effect> {
        if self.vehicle.as_ref() == Some(&id) {
            return Vec::new();
        }
        *live = Live::default();
        self.socket = Socket::Opening;
        self.vehicle = Some(id.clone());
        vec![Effect::Remember(id.clone()), Effect::OpenSocket(id)]
    }

    fn batch(&mut self, live: &mut Live, bytes: &[u8], local_ms: f64) -> Vec<Effect> {
        match live.ingest(bytes, local_ms) {
            Ok(()) => Vec::new(),
            // Said once: a batch of another schema is followed by many more.
            Err(error) if !self.schema_told => {
                self.schema_told = true;
                self.tell(Tone::Error, format!("Telemetry cannot be read: {error}. Reload the page after an update."))
            }
            Err(_) => Vec::new(),
        }
    }

    fn answered(&mut self, what: &str, result: Result<plumbline_rest::command::Answer, Failure>) -> Vec<Effect> {
        match result {
            Ok(answer) if answer.reason.is_empty() => self.tell(Tone::Done, format!("{what}: accepted")),
            Ok(answer) => self.tell(Tone::Done, format!("{what}: {}", answer.reason)),
            // Nobody refused it.
            Err(Failure { status: 0, text }) => self.tell(Tone::Error, format!("{what}: {text}")),
            Err(failure) => self.tell(Tone::Error, format!("{what} refused: {}", failure.text)),
        }
    }

    fn tell(&mut self, tone: Tone, text: String) -> Vec<Effect> {
        // The same words again replace the older notice, instead of piling up.
        self.notices.retain(|n| n.text != text);
        self.notice_number += 1;
        self.notices.push_back(Notice { number: self.notice_number, tone, text });
        while self.notices.len() > MAX_NOTICES {
            self.notices.pop_front();
        }
        let stay_ms = if tone == Tone::Error { 12_000 } else { 4000 };
        vec![Effect::DismissIn(self.notice_number, stay_ms)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_rest::command::Answer;

    fn vehicle(id: &str, connected: bool) -> Vehicle {
        Vehicle { id: id.into(), connected, ..Default::default() }
    }

    #[test]
    fn the_first_connected_vehicle_is_shown_unless_another_was() {
        let list = vec![vehicle("a", false), vehicle("b", true), vehicle("c", true)];
        let mut live = Live::default();
        let mut app = App::new(None);
        let effects = app.update(&mut live, Event::Vehicles(Ok(list.clone())));
        assert_eq!(effects, [Effect::Remember("b".into()), Effect::OpenSocket("b".into())]);
        let mut app = App::new(Some("c".into()));
        app.update(&mut live, Event::Vehicles(Ok(list.clone())));
        assert_eq!(app.vehicle.as_deref(), Some("c"));
        // A later list changes nothing.
        assert!(app.update(&mut live, Event::Vehicles(Ok(list))).is_empty());
    }

    #[test]
    fn reconnects_wait_longer_each_time_and_start_over_after_success() {
        let mut live = Live::default();
        let mut app = App::new(None);
        app.update(&mut live, Event::Choose("a".into()));
        let mut waits = Vec::new();
        for _ in 0..7 {
            waits.extend(app.update(&mut live, Event::SocketClosed));
            assert!(matches!(app.update(&mut live, Event::Reconnect)[0], Effect::OpenSocket(_)));
        }
        let expected = [250, 500, 1000, 2000, 4000, 4000, 4000].map(Effect::RetryIn);
        assert_eq!(waits, expected);
        app.update(&mut live, Event::SocketOpened);
        assert_eq!(app.update(&mut live, Event::SocketClosed), [Effect::RetryIn(250)]);
    }

    #[test]
    fn the_window_shown_is_filled_first_and_a_vehicle_that_is_not_there_is_left() {
        let mut live = Live::default();
        let mut app = App::new(None);
        app.update(&mut live, Event::Choose("a".into()));
        let first = app.update(&mut live, Event::SocketOpened);
        assert_eq!(first, [Effect::FetchHistory("a".into(), HISTORY_S)]);
        let then = app.update(&mut live, Event::History("a".into(), HISTORY_S, Box::new(Live::past(0))));
        assert_eq!(then, [Effect::FetchHistory("a".into(), MOST_HISTORY_S)]);
        assert!(app.update(&mut live, Event::History("a".into(), MOST_HISTORY_S, Box::new(Live::past(0)))).is_empty());
        app.update(&mut live, Event::SocketClosed);
        app.update(&mut live, Event::Vehicles(Ok(vec![vehicle("b", true)])));
        assert_eq!(app.vehicle.as_deref(), Some("b"));
    }

    #[test]
    fn a_vehicle_that_was_heard_of_is_not_left_for_one_that_a_restarted_ground_hears_first() {
        let mut live = Live::default();
        let mut app = App::new(None);
        // GIVEN a vehicle whose messages are shown
        app.update(&mut live, Event::Choose("a".into()));
        app.update(&mut live, Event::SocketOpened);
        live.clock.seen(1_000_000);
        // WHEN the ground is started again, and another vehicle connects first
        app.update(&mut live, Event::SocketClosed);
        let effects = app.update(&mut live, Event::Vehicles(Ok(vec![vehicle("b", true)])));
        // THEN commands still go to the one shown, and the list says so
        assert!(effects.is_empty());
        assert_eq!(app.vehicle.as_deref(), Some("a"));
        assert_eq!(app.offered(), [("b".to_owned(), true), ("a".to_owned(), false)]);
    }

    #[test]
    fn the_ground_is_asked_again_once_it_has_answered_or_has_not_in_time() {
        let mut live = Live::default();
        let mut app = App::new(None);
        assert_eq!(app.update(&mut live, Event::Poll), [Effect::FetchState]);
        assert!(app.update(&mut live, Event::Poll).is_empty());
        app.update(&mut live, Event::Ground(Ok(Ground::default())));
        assert!(app.update(&mut live, Event::Poll).is_empty(), "its vehicles are still asked for");
        app.update(&mut live, Event::Vehicles(Err(Failure { status: 0, text: String::new() })));
        assert_eq!(app.update(&mut live, Event::Poll), [Effect::FetchState]);
        app.update(&mut live, Event::Vehicles(Ok(Vec::new())));
        assert_eq!(app.update(&mut live, Event::Poll), [Effect::FetchState]);
    }

    #[test]
    fn refusals_keep_the_grounds_words_and_do_not_pile_up() {
        let mut live = Live::default();
        let mut app = App::new(None);
        for _ in 0..3 {
            let failure = Failure { status: 409, text: "battery 13.1 V below 14.0 V".into() };
            app.update(&mut live, Event::Answered("Arm".into(), Err(failure)));
        }
        assert_eq!(app.notices.len(), 1);
        assert_eq!(app.notices[0].text, "Arm refused: battery 13.1 V below 14.0 V");
        let done = app.update(&mut live, Event::Answered("Disarm".into(), Ok(Answer::default())));
        assert_eq!(done, [Effect::DismissIn(4, 4000)]);
        app.update(&mut live, Event::Dismiss(4));
        assert_eq!(app.notices.len(), 1);
        let failure = Failure { status: 0, text: "no answer within 10 s".into() };
        app.update(&mut live, Event::Answered("Arm".into(), Err(failure)));
        assert_eq!(app.notices[1].text, "Arm: no answer within 10 s");
    }

    #[test]
    fn a_foreign_schema_is_said_once() {
        let mut live = Live::default();
        let mut app = App::new(None);
        for _ in 0..10 {
            app.update(&mut live, Event::Batch(vec![0x50, 99], 0.0));
        }
        assert_eq!(app.notices.len(), 1);
        assert!(app.notices[0].text.contains("schema 99"));
    }
}
