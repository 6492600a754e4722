//! Talking to the ground: one WebSocket and plain requests. Everything ends in an [`Event`].

use serde::de::DeserializeOwned;
use wasm_bindgen::{JsCast, JsValue, closure::Closure};
use wasm_bindgen_futures::JsFuture;
use web_sys::{
    AbortSignal, BinaryType, MessageEvent, ReadableStreamDefaultReader, Request, RequestInit, Response, WebSocket,
};

use crate::{
    event::{Event, Failure},
    model::{api::failure_text, liveness},
};

/// Header that tells the ground which page sends a command.
const OPERATOR: &str = "X-Plumbline-Operator";
/// Header that tells the vehicle what its operator saw: flight time of the newest message shown, µs.
const SEEN: &str = "X-Plumbline-Seen";
/// The ground's state is waited for so long, ms: where nothing comes back, a question holds its connection no longer.
const STATE_MS: u32 = 3000;
/// And the answer to a command, ms: longer than the ground waits for the vehicle's, unless its `command_timeout_s` is set to
/// more than that. What became of the command after that nobody knows.
pub const COMMAND_MS: u32 = 10_000;

/// The browser's monotonic clock, ms.
pub fn now_ms() -> f64 {
    web_sys::window().and_then(|w| w.performance()).map_or(0.0, |p| p.now())
}

/// Seconds since the Unix epoch.
pub fn unix_s() -> f64 {
    js_sys::Date::now() * 1e-3
}

/// Nobody answered.
pub fn unreachable_ground() -> Failure {
    Failure { status: 0, text: failure_text(0, "") }
}

/// One request; its whole answer counts only if it has come before `overdue`.
async fn send(
    method: &str,
    url: &str,
    body: Option<String>,
    operator: &str,
    seen_us: u64,
    overdue: Option<&AbortSignal>,
) -> Result<Response, Failure> {
    let init = RequestInit::new();
    init.set_method(method);
    if overdue.is_some() {
        init.set_signal(overdue);
    }
    if let Some(body) = &body {
        init.set_body(&JsValue::from_str(body));
    }
    let request = Request::new_with_str_and_init(url, &init).map_err(|_| unreachable_ground())?;
    let headers = request.headers();
    if body.is_some() {
        headers.set("Content-Type", "application/json").map_err(|_| unreachable_ground())?;
    }
    // With a session the ground wants this header with whatever is not a GET: no foreign page can set it.
    let operator = if operator.is_empty() && method != "GET" { "page" } else { operator };
    if !operator.is_empty() {
        headers.set(OPERATOR, operator).map_err(|_| unreachable_ground())?;
    }
    if seen_us > 0 {
        headers.set(SEEN, &seen_us.to_string()).map_err(|_| unreachable_ground())?;
    }
    let window = web_sys::window().ok_or_else(unreachable_ground)?;
    let response = JsFuture::from(window.fetch_with_request(&request)).await.map_err(|_| unreachable_ground())?;
    let response: Response = response.dyn_into().map_err(|_| unreachable_ground())?;
    if response.ok() {
        return Ok(response);
    }
    Err(failed(response.status(), &text(&response).await.unwrap_or_default()))
}

fn failed(status: u16, text: &str) -> Failure {
    if status == 401 {
        // The session is over: the ground's own form begins another and comes back here.
        let _ = web_sys::window().map(|window| window.location().set_href("/login"));
    }
    Failure { status, text: failure_text(status, text) }
}

async fn text(response: &Response) -> Result<String, Failure> {
    let promise = response.text().map_err(|_| unreachable_ground())?;
    let value = JsFuture::from(promise).await.map_err(|_| unreachable_ground())?;
    Ok(value.as_string().unwrap_or_default())
}

/// One request whose answer is JSON (or nothing).
///
/// # Errors
/// [`Failure`] with the ground's own words.
pub async fn json<T: DeserializeOwned>(
    method: &str,
    url: &str,
    body: Option<String>,
    operator: &str,
) -> Result<T, Failure> {
    read(send(method, url, body, operator, 0, None).await?, url).await
}

/// What is asked for again and again: as [`json`], but not waited for without an end.
///
/// # Errors
/// [`Failure`] with the ground's own words.
pub async fn state<T: DeserializeOwned>(url: &str) -> Result<T, Failure> {
    let overdue = AbortSignal::timeout_with_u32(STATE_MS);
    read(send("GET", url, None, "", 0, Some(&overdue)).await?, url).await
}

/// A command to a vehicle, asked while the newest message shown was of flight time `seen_us` (0: none was). Its answer is waited
/// for no longer than `within_ms`; `None`: however late it comes.
///
/// # Errors
/// [`Failure`] with the ground's own words, or the vehicle's.
pub async fn command(
    method: &str,
    url: &str,
    body: String,
    operator: &str,
    seen_us: u64,
    within_ms: Option<u32>,
) -> Result<plumbline_rest::command::Answer, Failure> {
    let overdue = within_ms.map(AbortSignal::timeout_with_u32);
    let answer = match send(method, url, Some(body), operator, seen_us, overdue.as_ref()).await {
        Ok(response) => read(response, url).await,
        Err(failure) => Err(failure),
    };
    match (answer, within_ms) {
        (Err(Failure { status: 0, .. }), Some(ms)) if overdue.as_ref().is_some_and(AbortSignal::aborted) => {
            let text = format!("no answer within {} s, the vehicle may have carried it out", f64::from(ms) / 1000.0);
            Err(Failure { status: 0, text })
        }
        (answer, _) => answer,
    }
}

async fn read<T: DeserializeOwned>(response: Response, url: &str) -> Result<T, Failure> {
    parsed(&text(&response).await?, url)
}

fn parsed<T: DeserializeOwned>(text: &str, url: &str) -> Result<T, Failure> {
    let text = if text.trim().is_empty() { "{}" } else { text };
    serde_json::from_str(text)
        .map_err(|error| Failure { status: 0, text: format!("{url} answered with something else: {error}") })
}

/// One request whose answer is bytes.
///
/// # Errors
/// [`Failure`] with the ground's own words.
pub async fn bytes(url: &str) -> Result<Vec<u8>, Failure> {
    let mut all = Vec::new();
    pieces(url, |piece| {
        all.extend_from_slice(piece);
        Ok(())
    })
    .await?;
    Ok(all)
}

/// The same, which nobody holds whole: `take` is given each piece as it comes, until it refuses one.
///
/// # Errors
/// [`Failure`] with the ground's own words, or with those of `take`.
pub async fn pieces(url: &str, mut take: impl FnMut(&[u8]) -> Result<(), Failure>) -> Result<(), Failure> {
    let response = send("GET", url, None, "", 0, None).await?;
    let body = response.body().ok_or_else(unreachable_ground)?;
    let reader: ReadableStreamDefaultReader = body.get_reader().unchecked_into();
    loop {
        let piece = JsFuture::from(reader.read()).await.map_err(|_| unreachable_ground())?;
        let value = js_sys::Reflect::get(&piece, &"value".into()).unwrap_or(JsValue::UNDEFINED);
        // Without a value it is over.
        let Ok(piece) = value.dyn_into::<js_sys::Uint8Array>() else { return Ok(()) };
        if let Err(failure) = take(&piece.to_vec()) {
            // Nobody wants the rest, whatever becomes of it.
            let _ = reader.cancel();
            return Err(failure);
        }
    }
}

/// Sends files as a form; `sent` is told which share of them is on its way, 0 to 1.
///
/// # Errors
/// [`Failure`] with the ground's own words.
pub async fn upload<T: DeserializeOwned>(
    url: &str,
    form: &web_sys::FormData,
    operator: &str,
    sent: impl Fn(f64) + 'static,
) -> Result<T, Failure> {
    // What fetch cannot tell: how far it is.
    let request = web_sys::XmlHttpRequest::new().map_err(|_| unreachable_ground())?;
    request.open("POST", url).map_err(|_| unreachable_ground())?;
    let operator = if operator.is_empty() { "page" } else { operator };
    request.set_request_header(OPERATOR, operator).map_err(|_| unreachable_ground())?;
    let progress = Closure::<dyn FnMut(web_sys::ProgressEvent)>::new(move |event: web_sys::ProgressEvent| {
        sent(event.loaded() / event.total().max(1.0));
    });
    let uploading = request.upload().map_err(|_| unreachable_ground())?;
    uploading.set_onprogress(Some(progress.as_ref().unchecked_ref()));
    let over = js_sys::Promise::new(&mut |done, _| request.set_onloadend(Some(&done)));
    request.send_with_opt_form_data(Some(form)).map_err(|_| unreachable_ground())?;
    // Loaded or not, it is over.
    let _ = JsFuture::from(over).await;
    let status = request.status().unwrap_or(0);
    let text = request.response_text().ok().flatten().unwrap_or_default();
    if !(200..300).contains(&status) {
        return Err(failed(status, &text));
    }
    parsed(&text, url)
}

/// Has the browser keep what is at an address, under a name (empty: as the ground calls it).
pub fn download(url: &str, name: &str) {
    let document = web_sys::window().and_then(|w| w.document());
    let anchor = document.and_then(|d| d.create_element("a").ok());
    if let Some(anchor) = anchor.and_then(|a| a.dyn_into::<web_sys::HtmlAnchorElement>().ok()) {
        anchor.set_href(url);
        anchor.set_download(name);
        anchor.click();
    }
}

/// Has the browser keep a text as a file.
pub fn save(name: &str, mime: &str, text: &str) {
    // Without an address there is no file, and nothing to say but that none came.
    let Some(url) = address_of(mime, text) else { return };
    download(&url, name);
    let _ = web_sys::Url::revoke_object_url(&url);
}

/// Where the browser has a text, until the address is revoked.
fn address_of(mime: &str, text: &str) -> Option<String> {
    let kind = web_sys::BlobPropertyBag::new();
    kind.set_type(mime);
    let parts = js_sys::Array::of1(&JsValue::from_str(text));
    let blob = web_sys::Blob::new_with_str_sequence_and_options(&parts, &kind).ok()?;
    web_sys::Url::create_object_url_with_blob(&blob).ok()
}

/// Dots of a picture for each of its px: as sharp as print wants it.
const PNG_SCALE: f64 = 3.0;

/// Has the browser draw an SVG and keep it as a PNG.
pub fn save_png(name: &str, svg: &str) {
    let (name, svg) = (name.to_owned(), svg.to_owned());
    leptos::task::spawn_local(async move {
        let Some(url) = address_of("image/svg+xml", &svg) else { return };
        // A browser that cannot draw it makes no file, as one that cannot keep it.
        if let Ok(png) = drawn(&url).await {
            download(&png, &name);
        }
        let _ = web_sys::Url::revoke_object_url(&url);
    });
}

/// The picture at an address as a PNG, itself as an address.
async fn drawn(url: &str) -> Result<String, JsValue> {
    let image = web_sys::HtmlImageElement::new()?;
    image.set_src(url);
    JsFuture::from(image.decode()).await?;
    let document = web_sys::window().and_then(|window| window.document()).ok_or(JsValue::UNDEFINED)?;
    let canvas: web_sys::HtmlCanvasElement = document.create_element("canvas")?.dyn_into()?;
    let [width, height] = [image.natural_width(), image.natural_height()].map(|px| f64::from(px) * PNG_SCALE);
    canvas.set_width(width as u32);
    canvas.set_height(height as u32);
    let context = canvas.get_context("2d")?.ok_or(JsValue::UNDEFINED)?;
    let context: web_sys::CanvasRenderingContext2d = context.dyn_into().map_err(JsValue::from)?;
    context.draw_image_with_html_image_element_and_dw_and_dh(&image, 0.0, 0.0, width, height)?;
    canvas.to_data_url()
}

/// Lets the browser do other things for `ms`.
pub async fn pause(ms: f64) {
    let wait = js_sys::Promise::new(&mut |done, _| {
        if let Some(window) = web_sys::window() {
            // Fails only without a window.
            let _ = window.set_timeout_with_callback_and_timeout_and_arguments_0(&done, ms as i32);
        }
    });
    // A timer does not fail.
    let _ = JsFuture::from(wait).await;
}

/// The live socket. Closing it, or dropping it, ends its events.
pub struct LiveSocket {
    socket: WebSocket,
    _message: Closure<dyn FnMut(MessageEvent)>,
    _open: Closure<dyn FnMut()>,
    _close: Closure<dyn FnMut()>,
}

impl LiveSocket {
    /// Opens the socket of `vehicle`, as `operator`, or goes on with the one that `early.js` opened; `None` when the
    /// browser refuses at once. Whoever is in control shows by it that the page runs: see [`liveness`].
    pub fn open(vehicle: &str, operator: &str, dispatch: impl Fn(Event) + Clone + 'static) -> Option<Self> {
        let (socket, early) = match Early::take(vehicle, operator) {
            Some((socket, batches)) => (socket, batches),
            None => (Self::connect(vehicle, operator)?, Vec::new()),
        };
        let (on, back) = (dispatch.clone(), socket.clone());
        let message = Closure::<dyn FnMut(MessageEvent)>::new(move |event: MessageEvent| {
            if let Ok(buffer) = event.data().dyn_into::<js_sys::ArrayBuffer>() {
                let batch = js_sys::Uint8Array::new(&buffer).to_vec();
                if let Some(answer) = liveness::answer(&batch) {
                    // Not heard: the next one follows in a tenth of a second.
                    let _ = back.send_with_u8_array(&answer);
                }
                on(Event::Batch(batch, now_ms()));
            }
        });
        let on = dispatch.clone();
        let open = Closure::<dyn FnMut()>::new(move || on(Event::SocketOpened));
        let on = dispatch.clone();
        let close = Closure::<dyn FnMut()>::new(move || on(Event::SocketClosed));
        socket.set_onmessage(Some(message.as_ref().unchecked_ref()));
        socket.set_onopen(Some(open.as_ref().unchecked_ref()));
        socket.set_onclose(Some(close.as_ref().unchecked_ref()));
        if socket.ready_state() == WebSocket::OPEN {
            dispatch(Event::SocketOpened);
        }
        for batch in early {
            dispatch(Event::Batch(batch, now_ms()));
        }
        Some(Self { socket, _message: message, _open: open, _close: close })
    }

    fn connect(vehicle: &str, operator: &str) -> Option<WebSocket> {
        let location = web_sys::window()?.location();
        let scheme = if location.protocol().ok()? == "https:" { "wss" } else { "ws" };
        let id = js_sys::encode_uri_component(vehicle);
        let who = js_sys::encode_uri_component(operator);
        let host = location.host().ok()?;
        let url = format!("{scheme}://{host}/api/v1/vehicles/{id}/live?thinned=true&operator={who}");
        let socket = WebSocket::new(&url).ok()?;
        socket.set_binary_type(BinaryType::Arraybuffer);
        Some(socket)
    }
}

/// The socket that `early.js` opened before this program was here.
pub struct Early;

impl Early {
    fn get(name: &str) -> Option<(JsValue, JsValue)> {
        let early = js_sys::Reflect::get(&js_sys::global(), &"plumblineEarly".into()).ok()?;
        let value = js_sys::Reflect::get(&early, &name.into()).ok()?;
        Some((early, value))
    }

    /// The vehicle it shows.
    pub fn vehicle() -> Option<String> {
        Self::get("vehicle")?.1.as_string()
    }

    /// Who this page is.
    pub fn operator() -> Option<String> {
        Self::get("operator")?.1.as_string()
    }

    /// It, and what came through it so far; once, and only for the vehicle and operator it was opened for.
    fn take(vehicle: &str, operator: &str) -> Option<(WebSocket, Vec<Vec<u8>>)> {
        let ours = Self::vehicle().as_deref() == Some(vehicle) && Self::operator().as_deref() == Some(operator);
        let (socket, take) = (Self::get("socket"), Self::get("take"));
        // Taken or not: nobody else will, and what is not open yet need not be.
        let _ = js_sys::Reflect::delete_property(
            js_sys::global().unchecked_ref::<js_sys::Object>(),
            &"plumblineEarly".into(),
        );
        let (early, take) = take?;
        let socket: WebSocket = socket?.1.dyn_into().ok()?;
        let batches = take.dyn_into::<js_sys::Function>().ok()?.call0(&early).ok()?;
        if !ours || socket.ready_state() > WebSocket::OPEN {
            // Closing what is closed is no error worth telling.
            let _ = socket.close();
            return None;
        }
        let bytes = |buffer: JsValue| js_sys::Uint8Array::new(&buffer).to_vec();
        Some((socket, js_sys::Array::from(&batches).iter().map(bytes).collect()))
    }
}

impl Drop for LiveSocket {
    fn drop(&mut self) {
        self.socket.set_onmessage(None);
        self.socket.set_onopen(None);
        self.socket.set_onclose(None);
        // Closing a socket that never opened is no error worth telling.
        let _ = self.socket.close();
    }
}
