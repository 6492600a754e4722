//! A small HTTP/1.1 client over a plain socket, so that tests see the bytes a browser would, headers included.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use serde_json::Value;

use crate::xtask::XtaskError;

const LIMIT: Duration = Duration::from_secs(30);

/// Speaks to one ground, as one operator.
#[derive(Debug, Clone)]
pub struct Api {
    /// Where the ground listens.
    pub address: SocketAddr,
    /// The `X-Plumbline-Operator` of our commands.
    pub operator: String,
}

/// What the ground answered.
#[derive(Debug, Clone)]
pub struct Reply {
    /// Status code.
    pub status: u16,
    /// Header lines, names in lower case.
    pub headers: Vec<(String, String)>,
    /// Body, as it came.
    pub body: Vec<u8>,
}

impl Reply {
    /// The body as JSON; `null` when it is none.
    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_default()
    }

    /// The body as text.
    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }

    /// First header of that (lower-case) name.
    pub fn header(&self, name: &str) -> Option<&str> {
        self.headers.iter().find(|(header, _)| header == name).map(|(_, value)| value.as_str())
    }
}

impl Api {
    /// `GET`.
    ///
    /// # Errors
    /// The connection failed or the answer is no HTTP; a refusal is an answer.
    pub fn get(&self, path: &str) -> Result<Reply, XtaskError> {
        self.request("GET", path, None, &[])
    }

    /// `GET` whose answer must be 200 with JSON.
    ///
    /// # Errors
    /// As [`Api::get`], or any other status.
    pub fn get_json(&self, path: &str) -> Result<Value, XtaskError> {
        let reply = self.get(path)?;
        if reply.status == 200 { Ok(reply.json()) } else { Err(unexpected("GET", path, &reply)) }
    }

    /// A request with a JSON body whose answer must be 200.
    ///
    /// # Errors
    /// As [`Api::get`], or any other status.
    pub fn command(&self, method: &str, path: &str, body: &Value) -> Result<Value, XtaskError> {
        let reply = self.send(method, path, body)?;
        if reply.status == 200 { Ok(reply.json()) } else { Err(unexpected(method, path, &reply)) }
    }

    /// A request with a JSON body, whatever the answer.
    ///
    /// # Errors
    /// As [`Api::get`].
    pub fn send(&self, method: &str, path: &str, body: &Value) -> Result<Reply, XtaskError> {
        self.request(method, path, Some(body.to_string().as_bytes()), &[])
    }

    /// Any request, with any further headers.
    ///
    /// # Errors
    /// As [`Api::get`].
    pub fn request(
        &self,
        method: &str,
        path: &str,
        body: Option<&[u8]>,
        headers: &[(&str, &str)],
    ) -> Result<Reply, XtaskError> {
        let address = self.address;
        let failed = |source| XtaskError::Other(format!("{method} http://{address}{path}: {source}"));
        let mut request = format!(
            "{method} {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\nX-Plumbline-Operator: {}\r\n",
            self.operator
        );
        for (name, value) in headers {
            request.push_str(&format!("{name}: {value}\r\n"));
        }
        if let Some(body) = body {
            request.push_str(&format!("Content-Type: application/json\r\nContent-Length: {}\r\n", body.len()));
        }
        request.push_str("\r\n");
        let mut stream = TcpStream::connect_timeout(&address, LIMIT).map_err(failed)?;
        stream.set_read_timeout(Some(LIMIT)).map_err(failed)?;
        stream.write_all(request.as_bytes()).map_err(failed)?;
        stream.write_all(body.unwrap_or_default()).map_err(failed)?;
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).map_err(failed)?;
        parse(&answer).ok_or_else(|| {
            XtaskError::Other(format!("{method} {path}: no whole HTTP answer in {} bytes", answer.len()))
        })
    }
}

fn unexpected(method: &str, path: &str, reply: &Reply) -> XtaskError {
    XtaskError::Other(format!("{method} {path}: {} {}", reply.status, reply.text()))
}

fn parse(answer: &[u8]) -> Option<Reply> {
    let end = answer.windows(4).position(|window| window == b"\r\n\r\n")?;
    let (head, rest) = (answer.get(..end)?, answer.get(end + 4..)?);
    let head = String::from_utf8_lossy(head);
    let mut lines = head.split("\r\n");
    let status = lines.next()?.split(' ').nth(1)?.parse().ok()?;
    let headers: Vec<(String, String)> = lines
        .filter_map(|line| line.split_once(':'))
        .map(|(name, value)| (name.trim().to_ascii_lowercase(), value.trim().to_owned()))
        .collect();
    let value = |name: &str| headers.iter().find(|(header, _)| header == name).map(|(_, value)| value.as_str());
    let body = if value("transfer-encoding").is_some_and(|coding| coding.eq_ignore_ascii_case("chunked")) {
        unchunk(rest)?
    } else if let Some(length) = value("content-length") {
        rest.get(..length.parse().ok()?)?.to_vec()
    } else {
        rest.to_vec()
    };
    Some(Reply { status, headers, body })
}

/// Joins the chunks; a body cut short is no body.
fn unchunk(mut rest: &[u8]) -> Option<Vec<u8>> {
    let mut body = Vec::new();
    loop {
        let end = rest.windows(2).position(|window| window == b"\r\n")?;
        let size = std::str::from_utf8(rest.get(..end)?).ok()?;
        let size = usize::from_str_radix(size.split(';').next()?.trim(), 16).ok()?;
        rest = rest.get(end + 2..)?;
        if size == 0 {
            return Some(body);
        }
        body.extend_from_slice(rest.get(..size)?);
        rest = rest.get(size + 2..)?;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_and_chunked_answers_are_read_and_cut_ones_refused() {
        let plain = b"HTTP/1.1 409 Conflict\r\nContent-Length: 2\r\n\r\n{}";
        assert_eq!(parse(plain).unwrap().status, 409);
        let chunked = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n3\r\nabc\r\n2\r\nde\r\n0\r\n\r\n";
        assert_eq!(parse(chunked).unwrap().body, b"abcde");
        assert!(parse(&chunked[..chunked.len() - 8]).is_none());
        assert!(parse(&plain[..plain.len() - 1]).is_none());
    }
}
