//! What every route is asked and answers, as OpenAPI 3.1: made of the [operations](super::operations), the types of
//! `plumbline_rest` and the table of routes, which says who may. Served at `/api/v1/openapi.json`, and for people at
//! `/api/v1/docs`.

use std::collections::BTreeSet;

use axum::Json;
use axum::http::{StatusCode, header};
use axum::response::Html;
use plumbline_proto::v1;
use plumbline_rest::Problem;
use plumbline_rest::flight::Column;
use serde_json::{Map, Value, json};
use utoipa::ToSchema;

use super::error::PROBLEM;
use super::operations::OPERATIONS;
use super::operator::HEADER;
use super::session::{STYLE, escape};
use crate::names::JsonName;
use crate::people::{Access, COOKIE};
use crate::recorder::Format;

/// JSON.
const JSON: &str = "application/json";
/// Files.
const FORM: &str = "multipart/form-data";
/// Any bytes.
pub(super) const BYTES: &str = "application/octet-stream";

/// What an answer may lack: what is not there is left out, not null. Everything else is always sent.
const LEFT_OUT: [(&str, &[&str]); 10] = [
    ("Answer", &["revision"]),
    ("Calibration", &["covariance", "picture"]),
    ("EnvelopeMultiplier", &["sensor"]),
    (
        "EnvelopeSet",
        &[
            "altitude_m",
            "reached_m",
            "climb_mps",
            "drift_mps",
            "tilt_rad",
            "velocity_mps",
            "position_m",
            "reached",
            "binding",
            "attack",
            "certificate",
        ],
    ),
    ("Flight", &["outline"]),
    ("FlownAttack", &["sequence", "sequence_period_s"]),
    ("Lease", &["taken_from"]),
    ("PreparedAttack", &["probability", "altitude_m", "tilt_rad", "velocity_mps", "position_m", "note"]),
    ("Problem", &["holder", "command_id", "revision"]),
    ("Vehicle", &["ground"]),
];

/// The names of a set.
type Names = fn() -> Vec<String>;

/// Fields of bodies that take one of some names, where the whole set is known here: type, field, names.
const NAMED: [(&str, &str, Names); 7] = [
    ("Mode", "mode", || super::control::MODES.map(JsonName::json_name).to_vec()),
    ("Estimator", "estimator", names::<v1::EstimatorKind>),
    ("Decoder", "decoder", names::<v1::Decoder>),
    ("Trajectory", "shape", names::<v1::TrajectoryShape>),
    ("PlannedAttack", "sensor", names::<v1::SensorKind>),
    ("PlannedAttack", "channel", names::<v1::AttackChannel>),
    ("PlannedAttack", "kind", names::<v1::AttackKind>),
];

/// Names of a schema's enumeration, without the one that says nothing. None has a number beyond.
fn names<T: JsonName + TryFrom<i32>>() -> Vec<String> {
    let all = (0..64).filter_map(|number| T::try_from(number).ok()).map(JsonName::json_name);
    all.filter(|name| name != "unspecified").collect()
}

/// The schema of a parameter of a query, by what [`Parameter`] calls it.
fn schema_of(kind: &str) -> Value {
    let named = |names: Vec<String>| json!({ "type": "string", "enum": names });
    match kind {
        "estimator" => named(names::<v1::EstimatorKind>()),
        "column" => named(Column::ALL.map(|column| column.query().to_owned()).to_vec()),
        "format" => named(std::iter::once("mcap").chain(Format::ALL.map(Format::name)).map(str::to_owned).collect()),
        kind => json!({ "type": kind }),
    }
}

/// Schemas by name, and names that two types claim.
#[derive(Debug, Default)]
pub(super) struct Schemas {
    named: Map<String, Value>,
    /// Names of what is asked: there a field that may be left out has a meaning, or the value of before.
    asked: BTreeSet<String>,
    #[cfg_attr(not(test), allow(dead_code))]
    clashes: Vec<String>,
}

/// A schema, and what it refers to.
pub(super) type Schema = fn(&mut Schemas) -> Value;

/// The schema of a type of the contract.
pub(super) fn of<T: ToSchema>(schemas: &mut Schemas) -> Value {
    let mut found = Vec::new();
    T::schemas(&mut found);
    found.push((T::name().into_owned(), T::schema()));
    for (name, schema) in found {
        let schema = json!(schema);
        if schemas.named.get(&name).is_some_and(|known| *known != schema) {
            schemas.clashes.push(name.clone());
        }
        schemas.named.insert(name, schema);
    }
    json!({ "$ref": format!("#/components/schemas/{}", T::name()) })
}

impl Schemas {
    /// The schema of a body, and whether it is needed: an empty one is `{}`.
    fn asked(&mut self, schema: Schema) -> (Value, bool) {
        let mut own = Self::default();
        let body = schema(&mut own);
        let needed = named_in(&body).and_then(|name| own.named.get(name)).is_some_and(needs);
        self.asked.extend(own.named.keys().cloned());
        schema(self);
        (body, needed)
    }

    /// Says what answers always hold, and which names there are.
    fn complete(&mut self) {
        for (name, field, names) in NAMED {
            if let Some(field) = self.named.get_mut(name).and_then(|schema| schema["properties"].get_mut(field)) {
                field["enum"] = json!(names());
            }
        }
        let parts = self.named.clone();
        self.named.values_mut().filter(|schema| schema["allOf"].is_array()).for_each(|schema| merge(schema, &parts));
        for (name, schema) in self.named.iter_mut().filter(|(name, _)| !self.asked.contains(*name)) {
            let left_out = LEFT_OUT.iter().find(|(of, _)| of == name).map_or(&[] as &[&str], |(_, fields)| fields);
            always_sent(schema, left_out);
        }
    }
}

/// The name of the schema that is referred to.
fn named_in(schema: &Value) -> Option<&str> {
    schema["$ref"].as_str().and_then(|reference| reference.rsplit('/').next())
}

/// One object of the parts of a schema: a part that takes no other field would else refuse those of the others.
fn merge(schema: &mut Value, named: &Map<String, Value>) {
    let (mut properties, mut required) = (Map::new(), BTreeSet::new());
    for part in schema["allOf"].as_array().into_iter().flatten() {
        let part = named_in(part).and_then(|name| named.get(name)).unwrap_or(part);
        properties.extend(part["properties"].as_object().cloned().unwrap_or_default());
        required.extend(part["required"].as_array().into_iter().flatten().filter_map(Value::as_str).map(str::to_owned));
    }
    let description = schema["description"].take();
    *schema = json!({ "type": "object", "description": description, "properties": properties, "required": required });
}

/// Must any field be given?
fn needs(schema: &Value) -> bool {
    let of = |schema: &Value| schema["required"].as_array().is_some_and(|fields| !fields.is_empty());
    of(schema) || schema["allOf"].as_array().is_some_and(|parts| parts.iter().any(of))
}

/// Every field that is not left out at times is required.
fn always_sent(schema: &mut Value, left_out: &[&str]) {
    let fields = schema["properties"].as_object().into_iter().flat_map(Map::keys);
    let always: Vec<_> = fields.filter(|field| !left_out.contains(&field.as_str())).cloned().collect();
    if !always.is_empty() {
        schema["required"] = json!(always);
    }
}

/// A list of such.
pub(super) fn list<T: ToSchema>(schemas: &mut Schemas) -> Value {
    json!({ "type": "array", "items": of::<T>(schemas) })
}

/// An object of the agent's own files, whose fields are told elsewhere.
pub(super) fn object(_: &mut Schemas) -> Value {
    json!({ "type": "object" })
}

/// One of the query's parameters: name, type or what it names (see [`schema_of`]), with `!` where it is needed, what it means.
pub(super) type Parameter = (&'static str, &'static str, &'static str);

/// One method of one route.
#[derive(Clone, Copy)]
pub(super) struct Operation {
    method: &'static str,
    path: &'static str,
    summary: &'static str,
    query: &'static [Parameter],
    body: Option<Schema>,
    status: u16,
    answer: Option<(&'static str, Option<Schema>)>,
    /// Its body is a form with files.
    form: bool,
    /// 200 instead of 201 says that it was here already.
    known: bool,
    tagged: bool,
    ranged: bool,
}

impl Operation {
    pub(super) const fn new(method: &'static str, path: &'static str, summary: &'static str) -> Self {
        let (query, body, answer) = (&[] as &[Parameter], None, None);
        Self {
            method,
            path,
            summary,
            query,
            body,
            status: 204,
            answer,
            form: false,
            known: false,
            tagged: false,
            ranged: false,
        }
    }

    pub(super) const fn query(self, query: &'static [Parameter]) -> Self {
        Self { query, ..self }
    }

    pub(super) const fn takes(self, body: Schema) -> Self {
        Self { body: Some(body), ..self }
    }

    /// Files, as a form sends them.
    pub(super) const fn form(self) -> Self {
        Self { form: true, ..self }
    }

    /// It may have been done already: then 200 says so.
    pub(super) const fn known(self) -> Self {
        Self { known: true, ..self }
    }

    pub(super) const fn empty(self, status: u16) -> Self {
        Self { status, ..self }
    }

    pub(super) const fn json(self, answer: Schema) -> Self {
        Self { status: 200, answer: Some((JSON, Some(answer))), ..self }
    }

    pub(super) const fn created(self, answer: Schema) -> Self {
        Self { status: 201, ..self.json(answer) }
    }

    /// Anything but JSON.
    pub(super) const fn media(self, media: &'static str) -> Self {
        Self { status: 200, answer: Some((media, None)), ..self }
    }

    /// It has an ETag, although it is no JSON.
    pub(super) const fn tagged(self) -> Self {
        Self { tagged: true, ..self }
    }

    /// It is served in ranges, too.
    pub(super) const fn ranged(self) -> Self {
        Self { ranged: true, ..self.tagged() }
    }

    /// JSON that is read.
    fn json_read(&self) -> bool {
        self.method == "get" && self.answer.is_some_and(|(media, _)| media == JSON)
    }

    fn parameters(&self) -> Vec<Value> {
        let parts = self.path.split('/').filter_map(|part| part.strip_prefix('{')?.strip_suffix('}'));
        let path = |name| json!({ "name": name, "in": "path", "required": true, "schema": { "type": "string" } });
        let query = |(name, kind, text): &Parameter| {
            let (kind, required) = kind.strip_suffix('!').map_or((*kind, false), |kind| (kind, true));
            json!({ "name": name, "in": "query", "required": required, "description": text, "schema": schema_of(kind) })
        };
        let mut all: Vec<Value> = parts.map(path).chain(self.query.iter().map(query)).collect();
        if self.method != "get" {
            let text = "What a client calls itself; with a session it is needed, and the account counts.";
            let schema = json!({ "type": "string", "minLength": 1, "maxLength": 64 });
            all.push(json!({ "name": HEADER, "in": "header", "description": text, "schema": schema }));
        }
        let header =
            |name: &str, text, schema| json!({ "name": name, "in": "header", "description": text, "schema": schema });
        if self.tagged || self.json_read() {
            let text = "ETags with commas between them: what has one of them is not sent again.";
            all.push(header(header::IF_NONE_MATCH.as_str(), text, json!({ "type": "string" })));
        }
        if self.ranged {
            let text = "One range of bytes; what is none, or several, is passed over.";
            let range = json!({ "type": "string", "pattern": "^bytes=([0-9]+-[0-9]*|-[0-9]+)$" });
            all.push(header(header::RANGE.as_str(), text, range));
            let text = "An ETag: the range counts where it is one of the same bytes, else everything is sent.";
            all.push(header(header::IF_RANGE.as_str(), text, json!({ "type": "string" })));
        }
        all
    }

    fn document(&self, need: Access, schemas: &mut Schemas) -> Value {
        let content = match self.answer {
            None => Value::Null,
            Some((media, Some(schema))) => json!({ media: { "schema": schema(schemas) } }),
            Some((media, None)) => json!({ media: { "schema": { "type": "string" } } }),
        };
        let mut success = json!({ "description": self.summary });
        if !content.is_null() {
            success["content"] = content;
        }
        if self.tagged || self.json_read() {
            let text = "Identifies these bytes.";
            let tag =
                json!({ "description": text, "required": !self.tagged || self.ranged, "schema": { "type": "string" } });
            success["headers"] = json!({ "ETag": tag });
        }
        let mut responses = json!({ self.status.to_string(): success });
        if self.ranged {
            let mut part = success;
            part["description"] = json!("The range that was asked for.");
            part["headers"]["Content-Range"] = json!({ "required": true, "schema": { "type": "string" } });
            responses["206"] = part;
        }
        for status in self.failures() {
            responses[status.to_string()] = json!({ "$ref": format!("#/components/responses/{status}") });
        }
        if ["login", "logout"].contains(&self.tag()) {
            responses["303"] = json!({ "description": "Go on at `Location`." });
            for status in self.failures() {
                let mut failure = failure(status);
                failure["content"]["text/html; charset=utf-8"] = json!({ "schema": { "type": "string" } });
                responses[status.to_string()] = failure;
            }
        }
        if self.known {
            responses["200"] = responses[self.status.to_string()].clone();
        }
        if self.tagged || self.json_read() {
            responses["304"] = json!({ "description": "What `If-None-Match` names is still so." });
        }
        let mut operation = json!({
            "operationId": format!("{}{}", self.method, self.path.replace(['/', '{', '}', '-', '.'], "_")),
            "summary": self.summary,
            "tags": [self.tag()],
            "parameters": self.parameters(),
            "responses": responses,
        });
        if need == Access::Open {
            operation["security"] = json!([]);
        } else {
            operation["x-plumbline-role"] = json!(need.least().name());
        }
        if let Some(schema) = self.body {
            let (schema, needed) = schemas.asked(schema);
            operation["requestBody"] = json!({ "required": needed, "content": { JSON: { "schema": schema } } });
        }
        if self.form {
            let file = json!({ "type": "string", "contentMediaType": BYTES });
            let files = json!({ "type": "array", "items": file, "description": "One file, or those of one folder." });
            let schema = json!({ "type": "object", "properties": { "file": files }, "required": ["file"] });
            operation["requestBody"] = json!({ "required": true, "content": { FORM: { "schema": schema } } });
        }
        operation
    }

    /// Statuses by which it may say that it was not done.
    fn failures(&self) -> Vec<u16> {
        let mut all = vec![401, 403, 404, 405, 422, 500, 503];
        if self.method != "get" {
            all.extend([408, 409, 413]);
            if self.path.starts_with("/api/v1/vehicles/") {
                all.extend([423, 504]);
            }
        }
        if self.status == 101 {
            all.push(426);
        }
        if self.ranged {
            all.push(416);
        }
        let counted = ["session", "login", "flights", "archive"].contains(&self.tag());
        if counted {
            all.push(429);
        }
        all
    }

    /// The part of the path that names what it is about.
    fn tag(&self) -> &'static str {
        let path = self.path.strip_prefix("/api/v1/").unwrap_or(self.path).trim_start_matches('/');
        path.split('/').next().unwrap_or_default()
    }
}

/// What is said where something was not done.
fn failure(status: u16) -> Value {
    let reason = StatusCode::from_u16(status).ok().and_then(|status| status.canonical_reason()).unwrap_or_default();
    let mut failure = json!({
        "description": format!("{reason}: `code` says why to programs, `detail` to people."),
        "content": { PROBLEM: { "schema": { "$ref": "#/components/schemas/Problem" } } },
    });
    if status == 416 {
        failure["headers"] = json!({ "Content-Range": { "required": true, "schema": { "type": "string" } } });
    }
    failure
}

/// The whole document, and names that clash.
fn document() -> (Value, Schemas) {
    let mut schemas = Schemas::default();
    of::<Problem>(&mut schemas);
    let mut paths = Map::new();
    for (method, path, need) in super::access_table() {
        let described = OPERATIONS.iter().find(|operation| (operation.method, operation.path) == (method, path));
        if let Some(operation) = described {
            paths.entry(path).or_insert_with(|| json!({}))[method] = operation.document(need, &mut schemas);
        }
    }
    schemas.complete();
    let failures: BTreeSet<u16> = OPERATIONS.iter().flat_map(Operation::failures).collect();
    let text = "Times are in seconds or microseconds as their names say, lengths in metres, angles in radians, world east \
                north up. Every answer in JSON to a GET has an ETag.";
    let document = json!({
        "openapi": "3.1.0",
        "info": {
            "title": "Plumbline ground",
            "version": env!("CARGO_PKG_VERSION"),
            "description": text,
            "license": { "name": "MIT OR Apache-2.0", "identifier": "MIT OR Apache-2.0" },
        },
        "security": [{ "session": [] }],
        "paths": paths,
        "components": {
            "schemas": schemas.named.clone(),
            "responses": failures.into_iter().map(|status| (status.to_string(), failure(status))).collect::<Map<_, _>>(),
            "securitySchemes": {
                "session": { "type": "apiKey", "in": "cookie", "name": COOKIE, "description": "POST /api/v1/session gives it; where there are no accounts none is needed." },
            },
        },
    });
    (document, schemas)
}

/// `GET /api/v1/openapi.json`.
pub(crate) async fn show() -> Json<Value> {
    Json(document().0)
}

/// `GET /api/v1/docs`: the same for people, without a script and without a foreign file.
pub(crate) async fn docs() -> Html<String> {
    Html(page(&document().0))
}

fn page(document: &Value) -> String {
    let text = |value: &Value| escape(value.as_str().unwrap_or_default());
    let named = |schema: &Value| {
        let name = schema["$ref"].as_str().and_then(|name| name.rsplit('/').next());
        let list = schema["items"]["$ref"].as_str().and_then(|name| name.rsplit('/').next());
        match (name, list) {
            (Some(name), _) => format!("<a href=\"#{0}\">{0}</a>", escape(name)),
            (_, Some(name)) => format!("list of <a href=\"#{0}\">{0}</a>", escape(name)),
            _ => text(&schema["type"]),
        }
    };
    let media = |content: &Value| -> String {
        let each = content.as_object().into_iter().flatten();
        each.map(|(media, held)| format!("<code>{}</code> {}", escape(media), named(&held["schema"]))).collect()
    };
    let mut body = format!(
        "<p>{} <a href=/api/v1/openapi.json>openapi.json</a> says the same to programs. <a href=/>The page</a></p>",
        text(&document["info"]["description"])
    );
    for (path, methods) in document["paths"].as_object().into_iter().flatten() {
        for (method, operation) in methods.as_object().into_iter().flatten() {
            let role = operation["x-plumbline-role"].as_str().unwrap_or("nobody signed in");
            body += &format!(
                "<details><summary><b>{}</b> <code>{}</code> {}</summary><p>Needs: {role}.</p>",
                method.to_uppercase(),
                escape(path),
                text(&operation["summary"])
            );
            for parameter in operation["parameters"].as_array().into_iter().flatten() {
                let needed = if parameter["required"] == true { ", needed" } else { "" };
                let (name, kind) = (text(&parameter["name"]), text(&parameter["schema"]["type"]));
                let (place, meaning) = (text(&parameter["in"]), text(&parameter["description"]));
                body += &format!("<p><code>{name}</code> ({place}, {kind}{needed}) {meaning}</p>");
            }
            if !operation["requestBody"].is_null() {
                body += &format!("<p>Takes {}</p>", media(&operation["requestBody"]["content"]));
            }
            let answers = || operation["responses"].as_object().into_iter().flatten();
            for (status, answer) in answers().filter(|(status, _)| status.as_str() < "400") {
                body += &format!("<p>{status}: {} {}</p>", text(&answer["description"]), media(&answer["content"]));
            }
            let failures: Vec<_> = answers().map(|(status, _)| status.as_str()).filter(|s| *s >= "400").collect();
            body += &format!("<p>{}: <a href=\"#Problem\">Problem</a></p></details>", failures.join(", "));
        }
    }
    for (name, schema) in document["components"]["schemas"].as_object().into_iter().flatten() {
        let (name, schema) = (escape(name), escape(&format!("{schema:#}")));
        body += &format!("<details id=\"{name}\"><summary>{name}</summary><pre>{schema}</pre></details>");
    }
    let wide =
        "<style>body{max-width:60rem;margin:2rem auto}summary{cursor:pointer;padding:.2rem}pre{overflow:auto}</style>";
    format!(
        "<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content=\"width=device-width\">\
         <title>API – Plumbline</title>{STYLE}{wide}<main><h1>The API of this ground</h1>{body}</main></html>"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_route_is_described_and_nothing_else_is() {
        let routes: Vec<_> = super::super::access_table().into_iter().map(|(method, path, _)| (method, path)).collect();
        let described: Vec<_> = OPERATIONS.iter().map(|operation| (operation.method, operation.path)).collect();
        assert_eq!(described, routes, "in the order of the table of routes");
        assert_eq!(routes.iter().collect::<BTreeSet<_>>().len(), routes.len(), "each once");
        for (_, path) in routes {
            let apart = ["/login", "/logout", "/healthz", "/readyz", "/metrics"].contains(&path);
            assert!(apart || path.starts_with("/api/v1/"), "{path} has no version");
        }
    }

    #[test]
    fn every_schema_that_is_named_is_there_and_names_one_type() {
        let (document, schemas) = document();
        assert_eq!(schemas.clashes, Vec::<String>::new());
        let text = document.to_string();
        let mut named = 0;
        for part in text.split("#/components/schemas/").skip(1) {
            let name = part.split('"').next().unwrap();
            assert!(!document["components"]["schemas"][name].is_null(), "{name}");
            named += 1;
        }
        assert!(named > 80, "{named} references");
    }

    /// Fields that its source leaves out at times, by the type's name in the description; those of bodies apart.
    fn left_out_in(source: &str) -> Vec<(String, Vec<String>)> {
        let mut found = Vec::new();
        let (mut attributes, mut name, mut fields, mut skipped) = (String::new(), None, Vec::new(), false);
        for line in source.lines().map(str::trim) {
            if let Some(rest) = line.strip_prefix("pub struct ") {
                let renamed = attributes.split("schema(as = ").nth(1).and_then(|rest| rest.split(')').next());
                let own = rest.split([' ', ';', '(']).next().unwrap();
                name = Some(renamed.unwrap_or(own).to_owned());
            } else if line == "}" {
                if let Some(name) = name.take().filter(|_| !fields.is_empty() && !attributes.contains("deny_unknown")) {
                    found.push((name, std::mem::take(&mut fields)));
                }
                (fields, attributes) = (Vec::new(), String::new());
            } else if line.starts_with("#[") {
                if name.is_none() {
                    attributes += line;
                }
                skipped |= line.contains("skip_serializing_if");
            } else if let Some(field) = line.strip_prefix("pub ").filter(|_| std::mem::take(&mut skipped)) {
                fields.push(field.split(':').next().unwrap().to_owned());
            }
        }
        found
    }

    #[test]
    fn answers_have_every_field_that_is_always_sent_and_names_where_they_are_known() {
        let (document, described) = document();
        let schemas = document["components"]["schemas"].as_object().unwrap();
        let mut answers = 0;
        for (name, schema) in schemas.iter().filter(|(name, _)| !described.asked.contains(*name)) {
            let left_out = LEFT_OUT.iter().find(|(of, _)| of == name).map_or(&[] as &[&str], |(_, fields)| fields);
            assert!(schema["allOf"].is_null(), "{name} is of parts, of which one refuses the others' fields");
            let Some(fields) = schema["properties"].as_object() else { continue };
            let required: Vec<_> = schema["required"].as_array().into_iter().flatten().collect();
            for field in fields.keys() {
                let always = !left_out.contains(&field.as_str());
                assert_eq!(required.contains(&&json!(field)), always, "{name}.{field}");
            }
            answers += 1;
        }
        assert!(answers > 50, "{answers} answers");
        // What is left out is what the types leave out.
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../proto/rest/src");
        let mut told: Vec<_> = ["", "flight"]
            .iter()
            .flat_map(|sub| std::fs::read_dir(folder.join(sub)).unwrap().flatten())
            .filter(|file| file.path().extension().is_some_and(|ending| ending == "rs"))
            .flat_map(|file| left_out_in(&std::fs::read_to_string(file.path()).unwrap()))
            .filter(|(name, _)| schemas.contains_key(name) && !described.asked.contains(name))
            .collect();
        told.sort();
        // The fields of an attack are those of its plan.
        let listed: Vec<_> = LEFT_OUT
            .iter()
            .filter(|(name, _)| *name != "FlownAttack")
            .map(|(name, fields)| (name.to_string(), fields.iter().map(ToString::to_string).collect::<Vec<_>>()))
            .collect();
        assert_eq!(told, listed);
        for (name, field, names) in NAMED {
            let said = schemas[name]["properties"][field]["enum"].as_array().unwrap();
            assert!(said.len() == names().len() && said.len() > 3, "{name}.{field}: {said:?}");
        }
        let sort = &document["paths"]["/api/v1/flights"]["get"]["parameters"];
        let sort = sort.as_array().unwrap().iter().find(|parameter| parameter["name"] == "sort").unwrap();
        assert_eq!(sort["schema"]["enum"][0], "started");
        let needed = |path: &str, method: &str| document["paths"][path][method]["requestBody"]["required"].clone();
        assert_eq!(needed("/api/v1/vehicles/{id}/mode", "post"), true);
        assert_eq!(needed("/api/v1/vehicles/{id}/simulator", "post"), false, "an empty body is {{}}");
    }

    #[test]
    fn the_page_for_people_is_whole_without_any_other_file() {
        let page = page(&document().0);
        for needed in ["/api/v1/vehicles/{id}/cut", "Problem", "x-plumbline-operator"] {
            assert!(page.contains(needed), "{needed}");
        }
        for foreign in ["<script", "<link", "src=", "http:", "https:"] {
            assert!(!page.contains(foreign), "{foreign}");
        }
    }
}
