//! As much of HTTP as serves one page and opens WebSockets.

use super::access::Visit;
use std::io::{self, Read, Write};
use std::time::{Duration, Instant};

/// Heads of requests may be so long.
const MAX_HEAD: usize = 8192;
/// Headers at most.
const MAX_HEADERS: usize = 64;
/// A request's head must be there by then.
const HEAD_PATIENCE: Duration = Duration::from_secs(5);

/// What is asked for.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Request {
    /// `GET`, …
    pub method: String,
    /// The path, without what comes after `?`.
    pub path: String,
    host: Option<String>,
    origin: Option<String>,
    token: Option<String>,
    cookies: Option<String>,
    bearer: Option<String>,
    /// The key of a wish to open a WebSocket.
    pub websocket_key: Option<String>,
}

impl Request {
    /// What it says of who sent it.
    pub fn visit(&self) -> Visit<'_> {
        let (host, origin, token) = (self.host.as_deref(), self.origin.as_deref(), self.token.as_deref());
        Visit { host, origin, token, kept_token: None, bearer: self.bearer.as_deref() }
    }

    /// A cookie by its name.
    pub fn cookie(&self, name: &str) -> Option<&str> {
        let cookies = self.cookies.as_deref()?.split(';').filter_map(|pair| pair.trim().split_once('='));
        cookies.into_iter().find_map(|(of, value)| (of == name).then_some(value))
    }

    /// Reads the head of a request; its body, if any, is not read.
    ///
    /// # Errors
    /// When none comes in time, or it is too long or none at all.
    pub fn read(stream: &mut impl Read) -> io::Result<Self> {
        Self::read_bytes(stream).map(|(request, _)| request)
    }

    /// The same, with all bytes that were read for it.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn read_bytes(stream: &mut impl Read) -> io::Result<(Self, Vec<u8>)> {
        let (mut head, began) = (Vec::new(), Instant::now());
        let mut piece = [0; 1024];
        while head.len() < MAX_HEAD && began.elapsed() < HEAD_PATIENCE {
            let count = stream.read(&mut piece)?;
            if count == 0 {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
            head.extend_from_slice(&piece[..count]);
            if let Some(request) = Self::parse(&head)? {
                return Ok((request, head));
            }
        }
        Err(io::ErrorKind::InvalidData.into())
    }

    /// A request from its head; `None` when there is more to come.
    fn parse(head: &[u8]) -> io::Result<Option<Self>> {
        let mut headers = [httparse::EMPTY_HEADER; MAX_HEADERS];
        let mut parsed = httparse::Request::new(&mut headers);
        if parsed.parse(head).map_err(io::Error::other)?.is_partial() {
            return Ok(None);
        }
        let target = parsed.path.unwrap_or_default();
        let (path, query) = target.split_once('?').unwrap_or((target, ""));
        // Of a header given twice neither is believed.
        let value = |name: &str| {
            let mut found = parsed.headers.iter().filter(|header| header.name.eq_ignore_ascii_case(name));
            let value = found.next().and_then(|header| std::str::from_utf8(header.value).ok());
            value.filter(|_| found.next().is_none()).map(str::to_owned)
        };
        let upgrades = value("upgrade").is_some_and(|to| to.eq_ignore_ascii_case("websocket"));
        // A header that is there but unreadable must not pass for one that is not.
        let origins = parsed.headers.iter().any(|header| header.name.eq_ignore_ascii_case("origin"));
        Ok(Some(Self {
            method: parsed.method.unwrap_or_default().to_owned(),
            path: path.to_owned(),
            host: value("host"),
            origin: value("origin").or(origins.then(String::new)),
            cookies: value("cookie"),
            bearer: value("authorization").as_deref().and_then(bearer_token).map(str::to_owned),
            token: query.split('&').find_map(|pair| pair.strip_prefix("token=")).map(str::to_owned),
            websocket_key: value("sec-websocket-key").filter(|_| upgrades),
        }))
    }
}

/// The token of a header `Authorization: Bearer`.
fn bearer_token(header: &str) -> Option<&str> {
    let (scheme, token) = header.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| token.trim())
}

/// Sends a whole answer; the connection ends with it.
///
/// # Errors
/// When the client does not take it.
pub fn answer(stream: &mut impl Write, status: &str, kind: &str, body: &[u8]) -> io::Result<()> {
    answer_with(stream, status, kind, body, "")
}

/// The same with `more` headers, each with the end of its line.
///
/// # Errors
/// As [`answer`].
pub fn answer_with(
    stream: &mut impl Write,
    status: &str,
    kind: &str,
    body: &[u8],
    more: &str,
) -> io::Result<()> {
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}; charset=utf-8\r\nContent-Length: {}\r\nConnection: close\r\n\
         Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nX-Frame-Options: DENY\r\n\
         Referrer-Policy: no-referrer\r\nCross-Origin-Opener-Policy: same-origin\r\n\
         Cross-Origin-Resource-Policy: same-origin\r\n{more}\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes())?;
    stream.write_all(body)?;
    stream.flush()
}

/// Agrees to speak WebSocket from here on.
///
/// # Errors
/// When the client does not take it.
pub fn upgrade(stream: &mut impl Write, key: &str) -> io::Result<()> {
    let accept = tungstenite::handshake::derive_accept_key(key.as_bytes());
    let head = format!(
        "HTTP/1.1 101 Switching Protocols\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
         Sec-WebSocket-Accept: {accept}\r\n\r\n"
    );
    stream.write_all(head.as_bytes())?;
    stream.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heads_are_understood_however_they_come() {
        let text = "GET /ws?a=1&token=secret HTTP/1.1\r\nHost: localhost:1\r\norigin: http://localhost:1\r\n\
                    Cookie: loopbox-71=other; loopbox-7=kept\r\nUpgrade: WebSocket\r\nSec-WebSocket-Key: abc\r\n\r\n";
        struct Slow<'a>(&'a [u8]);
        impl Read for Slow<'_> {
            fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
                let count = self.0.len().min(7).min(out.len());
                out[..count].copy_from_slice(&self.0[..count]);
                self.0 = &self.0[count..];
                Ok(count)
            }
        }
        let request = Request::read(&mut Slow(text.as_bytes())).expect("a fine request");
        assert_eq!((&*request.method, &*request.path), ("GET", "/ws"));
        let visit = request.visit();
        assert_eq!(visit.host, Some("localhost:1"));
        assert_eq!(visit.origin, Some("http://localhost:1"));
        assert_eq!(visit.token, Some("secret"));
        assert_eq!((request.cookie("loopbox-7"), request.cookie("loopbox")), (Some("kept"), None));
        assert_eq!(request.websocket_key.as_deref(), Some("abc"));
        for (header, token) in
            [("Bearer key", Some("key")), ("bearer  key ", Some("key")), ("Basic key", None), ("key", None)]
        {
            let text = format!("GET / HTTP/1.1\r\nAuthorization: {header}\r\n\r\n");
            let request = Request::read(&mut text.as_bytes()).expect("a fine request");
            assert_eq!(request.visit().bearer, token, "{header}");
        }
    }

    #[test]
    fn bad_heads_are_refused() {
        let endless = format!("GET / HTTP/1.1\r\nA: {}", "a".repeat(2 * MAX_HEAD));
        for bad in ["", "GET / HT", "hello\r\n\r\n", &endless] {
            assert!(Request::read(&mut bad.as_bytes()).is_err(), "{}", &bad[..bad.len().min(20)]);
        }
        let twice = "GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil\r\nOrigin: a\r\nOrigin: b\r\n\r\n";
        let request = Request::read(&mut twice.as_bytes()).expect("it can be read");
        assert_eq!(request.visit().host, None);
        assert_eq!(request.visit().origin, Some(""));
    }
}
