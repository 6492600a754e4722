//! Recordings from elsewhere: chosen, or dropped on the list, and what becomes of each.

use leptos::prelude::*;
use plumbline_rest::flight::Imported;
use wasm_bindgen::{JsCast, JsValue};
use wasm_bindgen_futures::JsFuture;
use web_sys::{DragEvent, File, FileList, FileSystemDirectoryEntry, FileSystemEntry, FileSystemFileEntry, FormData};

use crate::{
    ctx::{Ctx, ctx},
    event::Failure,
    model::route::Route,
    net,
    panel::{toolbar::Link, waiting::Waiting},
};

/// How far one of them is.
#[derive(Debug, Clone, PartialEq)]
enum Stage {
    Waiting,
    /// Share of it that is sent.
    Sending(f64),
    Done(Imported),
    Failed(String),
}

/// One file, or the files of one folder.
#[derive(Clone)]
struct Recording {
    name: String,
    files: Vec<(File, String)>,
    stage: RwSignal<Stage>,
}

/// What is being imported.
#[derive(Clone, Copy)]
pub struct Importer {
    ctx: Ctx,
    all: RwSignal<Vec<Recording>, LocalStorage>,
    busy: RwSignal<bool>,
    /// Something is held over the list.
    pub over: RwSignal<bool>,
    done: Callback<()>,
}

impl Importer {
    /// `done` is called when a flight came of it.
    pub fn new(done: impl Fn() + Send + Sync + 'static) -> Self {
        Self {
            ctx: ctx(),
            all: RwSignal::new_local(Vec::new()),
            busy: RwSignal::new(false),
            over: RwSignal::new(false),
            done: Callback::new(move |()| done()),
        }
    }

    /// Each file on its own.
    fn files(self, list: &FileList) {
        self.add((0..list.length()).filter_map(|i| list.get(i)).map(|file| one(&file)).collect());
    }

    /// What was let go over the list; a folder is one recording.
    pub fn dropped(self, event: &DragEvent) {
        let Some(held) = event.data_transfer() else { return };
        // What was dropped is known to the browser during this event only.
        let items = held.items();
        let entries = (0..items.length()).filter_map(|i| items.get(i)?.webkit_get_as_entry().ok().flatten());
        let folders: Vec<FileSystemDirectoryEntry> =
            entries.filter(FileSystemEntry::is_directory).map(JsCast::unchecked_into).collect();
        if folders.is_empty() {
            if let Some(list) = held.files() {
                self.files(&list);
            }
            return;
        }
        leptos::task::spawn_local(async move {
            for folder in folders {
                let name = folder.name();
                let files = files_of(&folder).await;
                self.add(vec![Recording { name, files, stage: RwSignal::new(Stage::Waiting) }]);
            }
        });
    }

    fn add(self, recordings: Vec<Recording>) {
        self.all.update(|all| all.extend(recordings));
        if self.busy.get_untracked() {
            return;
        }
        self.busy.set(true);
        leptos::task::spawn_local(async move {
            let waiting = |recording: &&Recording| recording.stage.try_get_untracked() == Some(Stage::Waiting);
            let next = || self.all.try_with_untracked(|all| all.iter().find(waiting).cloned()).flatten();
            while let Some(recording) = next() {
                let answer = self.send(&recording).await;
                let stage = answer.map_or_else(|failure| Stage::Failed(failure.text), Stage::Done);
                let came = matches!(stage, Stage::Done(_));
                recording.stage.try_set(stage);
                if came {
                    self.done.try_run(());
                }
            }
            self.busy.try_set(false);
        });
    }

    async fn send(self, recording: &Recording) -> Result<Imported, Failure> {
        let stage = recording.stage;
        stage.try_set(Stage::Sending(0.0));
        let form = FormData::new().map_err(|_| net::unreachable_ground())?;
        for (file, name) in &recording.files {
            form.append_with_blob_and_filename("file", file, name).map_err(|_| net::unreachable_ground())?;
        }
        let operator = self.ctx.operator();
        net::upload("/api/v1/flights", &form, &operator, move |share| drop(stage.try_set(Stage::Sending(share)))).await
    }
}

fn one(file: &File) -> Recording {
    let name = file.name();
    Recording { name: name.clone(), files: vec![(file.clone(), name)], stage: RwSignal::new(Stage::Waiting) }
}

/// The files that lie in a folder itself, each with its path from there.
async fn files_of(folder: &FileSystemDirectoryEntry) -> Vec<(File, String)> {
    let reader = folder.create_reader();
    let entries = called(|done| reader.read_entries_with_callback(done)).await;
    let mut files = Vec::new();
    for entry in js_sys::Array::from(&entries.unwrap_or_default()).iter() {
        let entry: FileSystemEntry = entry.unchecked_into();
        if !entry.is_file() {
            continue;
        }
        let entry: FileSystemFileEntry = entry.unchecked_into();
        if let Some(file) = called(|done| {
            entry.file_with_callback(done);
            Ok(())
        })
        .await
        {
            let name = format!("{}/{}", folder.name(), entry.name());
            files.push((file.unchecked_into(), name));
        }
    }
    files
}

/// What a browser's call answers by calling back.
async fn called(call: impl FnOnce(&js_sys::Function) -> Result<(), JsValue>) -> Option<JsValue> {
    let mut call = Some(call);
    let answered = js_sys::Promise::new(&mut |done, failed| {
        if let Some(call) = call.take()
            && let Err(error) = call(&done)
        {
            // A promise that is over already hears nothing more.
            let _ = failed.call1(&JsValue::UNDEFINED, &error);
        }
    });
    JsFuture::from(answered).await.ok()
}

/// The button.
#[component]
pub fn ImportButton(importer: Importer) -> impl IntoView {
    let input = NodeRef::<leptos::html::Input>::new();
    let choose = move |_| {
        if let Some(input) = input.get_untracked() {
            input.click();
        }
    };
    view! {
        <button type="button" title="Flights of Plumbline, logs of PX4, recordings of BROAD or RotorPy; or drop them here, a Phantom 4's as its folder" on:click=choose>"Import…"</button>
        <input
            type="file"
            multiple
            hidden
            node_ref=input
            aria-label="Recordings to import"
            on:change:target=move |e| {
                if let Some(list) = e.target().files() {
                    importer.files(&list);
                }
                // The same file can be chosen again.
                e.target().set_value("");
            }
        />
    }
}

/// What becomes of each.
#[component]
pub fn Imports(importer: Importer) -> impl IntoView {
    let any = Memo::new(move |_| importer.all.with(|all| !all.is_empty()));
    let told = |recording: Recording| {
        let name = recording.name.clone();
        let what = move || {
            match recording.stage.get() {
                Stage::Waiting => view! { <span class="quiet">"waits"</span> }.into_any(),
                Stage::Sending(share) if share < 1.0 => {
                    view! { <Waiting text="is sent" share=Some(share) /> }.into_any()
                }
                Stage::Sending(_) => view! { <Waiting text="is read, and flown through every estimator" /> }.into_any(),
                Stage::Done(imported) => {
                    let said = if imported.already { "was here already: " } else { "is here: " };
                    let notes = imported.notes.join("; ");
                    view! { <span class="good">{said}</span><Link to=Route::Flight(imported.flight.clone())>"open the flight"</Link><span class="quiet">{notes}</span> }.into_any()
                }
                Stage::Failed(why) => {
                    // Its name stands before it already.
                    let why = why.strip_prefix(&format!("{}: ", recording.name)).map(str::to_owned).unwrap_or(why);
                    view! { <span class="bad">{why}</span> }.into_any()
                }
            }
        };
        view! { <li><b>{name}</b> {what}</li> }
    };
    view! {
        <Show when=move || any.get()>
            <section class="card imports" aria-label="Imports">
                <h2 class="visually-hidden">"Imports"</h2>
                <ul role="status">{move || importer.all.get().into_iter().map(told).collect::<Vec<_>>()}</ul>
                <button type="button" disabled=move || importer.busy.get() on:click=move |_| importer.all.set(Vec::new())>"Clear"</button>
            </section>
        </Show>
    }
}
