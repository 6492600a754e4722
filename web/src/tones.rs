//! What can be heard: a few notes for what must not be missed, so that nobody has to look at the page to know of it. They can
//! be switched off; a browser plays none before the page was clicked or a key was pressed.

use leptos::prelude::*;
use wasm_bindgen_futures::JsFuture;
use web_sys::{AudioContext, OscillatorType};

use crate::store;

/// What is sounded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tune {
    /// A failsafe acts.
    Failsafe,
    /// What is shown is old.
    Old,
    /// The battery is low; again and again while it is nearly empty.
    Battery,
    /// Another operator took control.
    Lost,
}

impl Tune {
    /// Its notes, Hz; each is another tune.
    const fn notes(self) -> &'static [f32] {
        match self {
            Self::Failsafe => &[988.0, 740.0, 988.0, 740.0],
            Self::Old => &[330.0, 330.0],
            Self::Battery => &[523.0, 440.0, 349.0],
            Self::Lost => &[660.0, 880.0],
        }
    }
}

/// Length of a note, s, and how loud it is, 0 to 1.
const NOTE_S: f64 = 0.16;
const LOUD: f32 = 0.22;
/// A note begins and ends within this, s: without it there are clicks.
const EDGE_S: f64 = 0.012;

/// Plays tunes, unless they are switched off.
#[derive(Clone, Copy)]
pub struct Tones {
    /// Are they on?
    pub on: RwSignal<bool>,
    context: StoredValue<Option<AudioContext>, LocalStorage>,
}

impl Default for Tones {
    fn default() -> Self {
        let on = RwSignal::new(store::get("tones").as_deref() != Some("off"));
        Self { on, context: StoredValue::new_local(None) }
    }
}

impl Tones {
    /// Switches them on or off, and keeps that.
    pub fn switch(self, on: bool) {
        self.on.set(on);
        store::set("tones", if on { "on" } else { "off" });
    }

    /// Plays a tune; nothing where they are off, or where the browser has no sound.
    pub fn play(self, tune: Tune) {
        if !self.on.get_untracked() {
            return;
        }
        self.context.update_value(|context| {
            if context.is_none() {
                *context = AudioContext::new().ok();
            }
            // Without sound the alarm is still on the page.
            let _ = context.as_ref().map(|context| sound(context, tune.notes()));
        });
    }
}

fn sound(context: &AudioContext, notes: &[f32]) -> Result<(), wasm_bindgen::JsValue> {
    // A browser that lets nothing sound before a click has it asleep.
    let woken = context.resume()?;
    leptos::task::spawn_local(async move {
        let _ = JsFuture::from(woken).await;
    });
    let begin_s = context.current_time() + EDGE_S;
    for (k, hz) in notes.iter().enumerate() {
        let (from_s, note) = (begin_s + k as f64 * NOTE_S, context.create_oscillator()?);
        let (volume, to_s) = (context.create_gain()?, from_s + NOTE_S);
        note.set_type(OscillatorType::Triangle);
        note.frequency().set_value(*hz);
        volume.gain().set_value_at_time(0.0, from_s)?;
        volume.gain().linear_ramp_to_value_at_time(LOUD, from_s + EDGE_S)?;
        volume.gain().set_value_at_time(LOUD, to_s - 2.0 * EDGE_S)?;
        volume.gain().linear_ramp_to_value_at_time(0.0, to_s - EDGE_S)?;
        note.connect_with_audio_node(&volume)?;
        volume.connect_with_audio_node(&context.destination())?;
        note.start_with_when(from_s)?;
        note.stop_with_when(to_s)?;
    }
    Ok(())
}
