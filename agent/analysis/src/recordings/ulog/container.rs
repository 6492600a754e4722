//! The container: definitions, subscriptions, data messages (docs.px4.io, "ULog File Format").
//!
//! Own code, because both libraries end the program at a bad file: `yule_log` 0.4 at the length of an array (it is
//! allocated, or too large a number), `px4-ulog` 0.6 at a subscription or a parameter shorter than its header. The one
//! allocates for every field of every message and brings `regex` and `env_logger`; the other ends the log at the first
//! message that is shorter than its format, and takes 20 ms for a file of 4 MB where this takes 12.

use std::collections::HashMap;
use std::rc::Rc;

pub(in crate::recordings) const MAGIC: &[u8] = b"ULog\x01\x12\x35";

/// Magic (7), version (1), start time (8).
const HEADER: usize = 16;
/// A message's length is 16 bits wide.
const MAX_MESSAGE: usize = u16::MAX as usize;
/// Formats within formats.
const MAX_DEPTH: usize = 8;

#[derive(Debug, Clone, Copy)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Scalar {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "int8_t" | "char" => Scalar::I8,
            "uint8_t" | "bool" => Scalar::U8,
            "int16_t" => Scalar::I16,
            "uint16_t" => Scalar::U16,
            "int32_t" => Scalar::I32,
            "uint32_t" => Scalar::U32,
            "int64_t" => Scalar::I64,
            "uint64_t" => Scalar::U64,
            "float" => Scalar::F32,
            "double" => Scalar::F64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Scalar::I8 | Scalar::U8 => 1,
            Scalar::I16 | Scalar::U16 => 2,
            Scalar::I32 | Scalar::U32 | Scalar::F32 => 4,
            Scalar::I64 | Scalar::U64 | Scalar::F64 => 8,
        }
    }

    fn read(self, bytes: &[u8]) -> Option<f64> {
        fn le<const N: usize>(bytes: &[u8]) -> Option<[u8; N]> {
            bytes.first_chunk::<N>().copied()
        }
        Some(match self {
            Scalar::I8 => f64::from(i8::from_le_bytes(le(bytes)?)),
            Scalar::U8 => f64::from(u8::from_le_bytes(le(bytes)?)),
            Scalar::I16 => f64::from(i16::from_le_bytes(le(bytes)?)),
            Scalar::U16 => f64::from(u16::from_le_bytes(le(bytes)?)),
            Scalar::I32 => f64::from(i32::from_le_bytes(le(bytes)?)),
            Scalar::U32 => f64::from(u32::from_le_bytes(le(bytes)?)),
            Scalar::I64 => i64::from_le_bytes(le(bytes)?) as f64,
            Scalar::U64 => u64::from_le_bytes(le(bytes)?) as f64,
            Scalar::F32 => f64::from(f32::from_le_bytes(le(bytes)?)),
            Scalar::F64 => f64::from_le_bytes(le(bytes)?),
        })
    }
}

/// A number, or an array of them, in the data of a message.
#[derive(Debug, Clone, Copy)]
struct Field {
    offset: usize,
    scalar: Scalar,
    count: usize,
}

/// The fields of one message format that are plain numbers, by name.
type Layout = HashMap<String, Field>;

/// One data message of a subscribed topic.
pub(super) struct Message<'a> {
    pub(super) topic: &'a str,
    /// Of several publishers of one topic.
    pub(super) instance: u8,
    layout: &'a Layout,
    data: &'a [u8],
}

impl Message<'_> {
    /// The number in this field; the first one of an array. `None` where the message has no such field.
    pub(super) fn get(&self, field: &str) -> Option<f64> {
        self.element(field, 0)
    }

    /// One element of an array.
    pub(super) fn element(&self, field: &str, index: usize) -> Option<f64> {
        let Field { offset, scalar, count } = *self.layout.get(field)?;
        (index < count).then_some(())?;
        scalar.read(self.data.get(offset + index * scalar.size()..)?)
    }

    /// The first `N` elements of an array.
    pub(super) fn array<const N: usize>(&self, field: &str) -> Option<[f64; N]> {
        let mut values = [0.0; N];
        for (index, value) in values.iter_mut().enumerate() {
            *value = self.element(field, index)?;
        }
        Some(values)
    }
}

/// Start of the log, µs since the start of the vehicle.
///
/// # Errors
/// It is no ULog.
pub(super) fn start_us(bytes: &[u8]) -> Result<u64, String> {
    let header =
        bytes.first_chunk::<HEADER>().ok_or_else(|| format!("{} bytes: shorter than a ULog header", bytes.len()))?;
    let [_, _, _, _, _, _, _, _, start @ ..] = *header;
    if header.starts_with(MAGIC) { Ok(u64::from_le_bytes(start)) } else { Err("not a ULog file".into()) }
}

/// Passes every data message to `each`, in the order of the file. Answers whether the file is whole: one that is cut
/// short is read up to the cut.
///
/// # Errors
/// A subscription whose format is missing or no format.
pub(super) fn each_message(bytes: &[u8], mut each: impl FnMut(&Message<'_>)) -> Result<bool, String> {
    let mut rest = bytes.get(HEADER..).unwrap_or_default();
    let mut formats: HashMap<String, String> = HashMap::new();
    let mut layouts: HashMap<String, Rc<Layout>> = HashMap::new();
    let mut topics: HashMap<u16, (String, u8, Rc<Layout>)> = HashMap::new();
    while let Some((&[s0, s1, kind], after)) = rest.split_first_chunk::<3>() {
        let size = usize::from(u16::from_le_bytes([s0, s1]));
        let Some((body, next)) = after.split_at_checked(size) else { return Ok(false) };
        rest = next;
        match kind {
            b'F' => {
                let text = String::from_utf8_lossy(body);
                if let Some((name, fields)) = text.split_once(':') {
                    formats.insert(name.to_owned(), fields.to_owned());
                }
            }
            b'A' => {
                if let Some((&[instance, i0, i1], name)) = body.split_first_chunk::<3>() {
                    let name = String::from_utf8_lossy(name).into_owned();
                    let layout = match layouts.get(&name) {
                        Some(layout) => layout.clone(),
                        None => layouts.entry(name.clone()).or_insert(Rc::new(layout(&formats, &name)?)).clone(),
                    };
                    topics.insert(u16::from_le_bytes([i0, i1]), (name, instance, layout));
                }
            }
            b'D' => {
                if let Some((&[i0, i1], data)) = body.split_first_chunk::<2>()
                    && let Some((topic, instance, layout)) = topics.get(&u16::from_le_bytes([i0, i1]))
                {
                    each(&Message { topic, instance: *instance, layout, data });
                }
            }
            _ => {}
        }
    }
    Ok(true)
}

/// Where a format's numeric fields are; nested formats count for their size.
fn layout(formats: &HashMap<String, String>, name: &str) -> Result<Layout, String> {
    let mut layout = Layout::new();
    let mut offset = 0;
    let fields = formats.get(name).ok_or_else(|| format!("topic {name:?} has no format"))?;
    for field in fields.split(';').filter(|f| !f.is_empty()) {
        let (type_text, field_name) =
            field.split_once(' ').ok_or_else(|| format!("format {name}: field {field:?} has no name"))?;
        let (base, count) = array_of(type_text)?;
        if let Some(scalar) = Scalar::parse(base) {
            layout.insert(field_name.to_owned(), Field { offset, scalar, count });
        }
        offset = within(offset + count * size_of(formats, base, 0)?)?;
    }
    Ok(layout)
}

/// Type of the elements, and how many there are.
fn array_of(type_text: &str) -> Result<(&str, usize), String> {
    let Some((base, rest)) = type_text.split_once('[') else { return Ok((type_text, 1)) };
    match rest.trim_end_matches(']').parse() {
        Ok(count @ 1..=MAX_MESSAGE) => Ok((base, count)),
        _ => Err(format!("array type {type_text:?}")),
    }
}

/// Bytes of one element of this type. At least one, so that the bound on the sum bounds the work, too.
fn size_of(formats: &HashMap<String, String>, name: &str, depth: usize) -> Result<usize, String> {
    if let Some(scalar) = Scalar::parse(name) {
        return Ok(scalar.size());
    }
    if depth > MAX_DEPTH {
        return Err(format!("format {name:?} nests deeper than {MAX_DEPTH}"));
    }
    let fields = formats.get(name).ok_or_else(|| format!("unknown type {name:?}"))?;
    let mut size = 0;
    for field in fields.split(';').filter(|f| !f.is_empty()) {
        let (base, count) = array_of(field.split(' ').next().unwrap_or_default())?;
        size = within(size + count * size_of(formats, base, depth + 1)?)?;
    }
    if size == 0 { Err(format!("format {name:?} has no fields")) } else { Ok(size) }
}

fn within(size: usize) -> Result<usize, String> {
    if size > MAX_MESSAGE { Err(format!("a format of {size} bytes, limit {MAX_MESSAGE}")) } else { Ok(size) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(kind: u8, body: &[u8]) -> Vec<u8> {
        [&(body.len() as u16).to_le_bytes()[..], &[kind], body].concat()
    }

    fn file(blocks: &[(u8, &[u8])]) -> Vec<u8> {
        let mut out = [MAGIC, &[1], &7_u64.to_le_bytes()].concat();
        blocks.iter().for_each(|(kind, body)| out.extend(block(*kind, body)));
        out
    }

    #[test]
    fn nested_formats_count_for_their_size() {
        let bytes = file(&[
            (b'F', b"inner:uint8_t[3] a;int16_t b;"),
            (b'F', b"outer:uint64_t timestamp;inner[2] skipped;int8_t c;float[2] d;"),
            (b'A', b"\x02\x05\x00outer"),
            (b'D', &[&[5, 0][..], &9_u64.to_le_bytes(), &[0; 10], &[0xFF], &1.5_f32.to_le_bytes(), &[0; 2]].concat()),
        ]);
        assert_eq!(start_us(&bytes), Ok(7));
        let mut seen = 0;
        let whole = each_message(&bytes, |message| {
            seen += 1;
            assert_eq!((message.topic, message.instance), ("outer", 2));
            assert_eq!(
                (message.get("timestamp"), message.get("c"), message.get("d")),
                (Some(9.0), Some(-1.0), Some(1.5))
            );
            // The data ends within the second element; there is no third, and nested fields have no name.
            assert_eq!((message.element("d", 1), message.element("d", 2), message.get("a")), (None, None, None));
            assert_eq!(message.array::<2>("d"), None);
        });
        assert_eq!((whole, seen), (Ok(true), 1));
        assert_eq!(each_message(&bytes[..bytes.len() - 1], |_| {}), Ok(false));
    }

    #[test]
    fn no_format_costs_more_than_a_message_can_hold() {
        let refused = |formats: &[&str]| {
            let mut blocks: Vec<(u8, &[u8])> = formats.iter().map(|format| (b'F', format.as_bytes())).collect();
            blocks.push((b'A', b"\0\0\0a"));
            each_message(&file(&blocks), |_| {}).unwrap_err()
        };
        for length in ["0", "65536", "18446744073709551615", "99999999999999999999999", "x"] {
            let text = format!("float[{length}]");
            assert_eq!(refused(&[&format!("a:{text} b;")]), format!("array type {text:?}"));
        }
        assert_eq!(refused(&["a:float[20000] b;"]), "a format of 80000 bytes, limit 65535");
        assert_eq!(refused(&["a:a b;"]), "format \"a\" nests deeper than 8");
        assert_eq!(refused(&["a:b c;", "b:"]), "format \"b\" has no fields");
        // Thousands of fields, each of the next format: the sum is over the limit before the work is.
        let chain: Vec<String> = "abcdefg"
            .chars()
            .zip("bcdefgh".chars())
            .map(|(name, next)| format!("{name}:{}", format!("{next} x;").repeat(5000)))
            .collect();
        let mut formats: Vec<&str> = chain.iter().map(String::as_str).collect();
        formats.push("h:uint8_t x;");
        assert_eq!(refused(&formats), "a format of 70000 bytes, limit 65535");
        assert_eq!(refused(&["b:float c;"]), "topic \"a\" has no format");
    }
}
