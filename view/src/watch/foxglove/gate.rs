//! Who may connect as Foxglove. Its server takes everybody, and a WebSocket may be opened from any page of the web; so
//! it listens where nobody looks, and this gate stands before it.

use super::super::web::access::{Visit, is_own_name};
use super::super::web::http::{self, Request};
use anyhow::{Context as _, Result};
use std::io::{self, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// Where Foxglove's own page is served: the one page of others that may connect.
const FOXGLOVE_APP: &str = "https://app.foxglove.dev";
/// Connections at a time.
const MAX_CONNECTIONS: usize = 12;
/// The wait for a request's head ends after this.
const READ_PATIENCE: Duration = Duration::from_secs(3);

/// An address of this machine's own that no page can guess: one of 16 million, at any port.
///
/// # Errors
/// When the system has no random numbers.
pub fn hidden_address() -> Result<Ipv4Addr> {
    let mut bytes = [0u8; 3];
    getrandom::fill(&mut bytes).context("the system gives no random numbers to hide Foxglove's server by")?;
    // Neither the network's own address nor that of all.
    let last = bytes[2].clamp(2, 254);
    Ok(Ipv4Addr::new(127, bytes[0], bytes[1], last))
}

/// Lets in, at a port of 127.0.0.1, who may see what is served at `inner`; says where.
///
/// # Errors
/// When the port cannot be listened at.
pub fn open(port: u16, inner: SocketAddr) -> Result<SocketAddr> {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port))?;
    let at = listener.local_addr()?;
    let inside = Arc::new(AtomicUsize::new(0));
    std::thread::Builder::new().name("foxglove gate".into()).spawn(move || {
        for stream in listener.incoming() {
            let Ok(stream) = stream else {
                // Out of files, say: not for ever.
                std::thread::sleep(Duration::from_millis(50));
                continue;
            };
            let seat = Seat::new(&inside);
            if inside.load(Ordering::Acquire) <= MAX_CONNECTIONS {
                // Without a thread the client is refused. Errors are the client's leaving.
                let pass = move || drop((pass(stream, inner), seat));
                let _ = std::thread::Builder::new().name("foxglove client".into()).spawn(pass);
            }
        }
    })?;
    Ok(at)
}

/// A connection, counted while it lives.
struct Seat(Arc<AtomicUsize>);

impl Seat {
    fn new(inside: &Arc<AtomicUsize>) -> Self {
        inside.fetch_add(1, Ordering::AcqRel);
        Self(Arc::clone(inside))
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Whether a request may be passed on, and why not. Pages of the web always say their origin; programs say none, or,
/// where they are made as pages, one of another scheme.
fn admit(visit: &Visit) -> Result<(), &'static str> {
    let Some(host) = visit.host.filter(|host| is_own_name(host)) else {
        return Err("this is served to this machine only: connect to 127.0.0.1 or localhost");
    };
    let own = |origin: &str| origin.strip_prefix("http://") == Some(host) || origin == FOXGLOVE_APP;
    let of_program = |origin: &str| {
        origin.split_once("://").is_some_and(|(scheme, _)| !["http", "https"].contains(&scheme))
    };
    match visit.origin {
        Some(origin) if !own(origin) && !of_program(origin) => Err("another page may not look at this run"),
        _ => Ok(()),
    }
}

/// Passes a connection on, both ways, until one side ends it.
fn pass(mut client: TcpStream, inner: SocketAddr) -> io::Result<()> {
    client.set_read_timeout(Some(READ_PATIENCE))?;
    let (request, head) = Request::read_bytes(&mut client)?;
    if let Err(reason) = admit(&request.visit()) {
        return http::answer(&mut client, "403 Forbidden", "text/plain", reason.as_bytes());
    }
    client.set_read_timeout(None)?;
    client.set_nodelay(true)?;
    let mut server = TcpStream::connect(inner)?;
    server.set_nodelay(true)?;
    server.write_all(&head)?;
    let (mut from_client, mut to_server) = (client.try_clone()?, server.try_clone()?);
    let upward = std::thread::Builder::new().name("foxglove client".into()).spawn(move || {
        let _ = io::copy(&mut from_client, &mut to_server);
        let _ = to_server.shutdown(Shutdown::Both);
    })?;
    let copied = io::copy(&mut server, &mut client);
    let _ = client.shutdown(Shutdown::Both);
    let _ = upward.join();
    copied.map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn programs_and_foxglove_may_connect_and_pages_may_not() {
        fn admits(host: Option<&str>, origin: Option<&str>) -> bool {
            admit(&Visit { host, origin, ..Visit::default() }).is_ok()
        }
        for host in ["127.0.0.1:8765", "localhost:8765", "localhost"] {
            assert!(admits(Some(host), None) && admits(Some(host), Some(FOXGLOVE_APP)), "{host}");
            let own = format!("http://{host}");
            assert!(admits(Some(host), Some(&*own)), "{host}");
        }
        assert!(admits(Some("127.0.0.1:8765"), Some("file://")));
        for origin in ["http://evil.example", "null", "", "https://app.foxglove.dev.evil.example"] {
            assert!(!admits(Some("127.0.0.1:8765"), Some(origin)), "{origin}");
        }
        assert!(!admits(Some("evil.example:8765"), None) && !admits(None, None));
    }
}
