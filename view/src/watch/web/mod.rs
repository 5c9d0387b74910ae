//! The page in the browser: one HTML page and a WebSocket for it, a thread for each client.

pub(super) mod access;
mod client;
mod encode;
pub(super) mod http;
mod page;
mod run;

pub use access::Address;
pub use client::Teller;
pub use encode::picture as picture_message;
pub use tungstenite::Message;

use super::Shared;
use crate::report::script::Script;
use crate::script;
use anyhow::{Context, Result};
use http::Request;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// The scripts with which a page takes in what it is sent.
pub const FEED_SCRIPTS: [Script; 2] = [script!("../assets/decode.js"), script!("../assets/feed.js")];

/// The port where none is given and it is free.
pub const USUAL_PORT: u16 = 7171;
/// Connections at a time.
const MAX_CONNECTIONS: usize = 12;
/// Every wait for a request's head ends after this.
const READ_PATIENCE: Duration = Duration::from_secs(3);
/// How long an end waits for pages to get the last of it.
const FAREWELL: Duration = Duration::from_secs(2);
/// Guesses at a token are slowed down by this.
const REFUSAL_DELAY: Duration = Duration::from_millis(200);

/// A page being served, by threads that end with the process.
pub struct Server {
    url: String,
    connections: Arc<AtomicUsize>,
}

/// What every connection needs.
struct Site {
    address: Address,
    page: String,
    open: Box<dyn Fn() -> Box<dyn Teller> + Send + Sync>,
    connections: Arc<AtomicUsize>,
}

impl Server {
    /// Begins to serve a scene.
    ///
    /// # Errors
    /// When the address cannot be listened at.
    pub fn start(shared: &Arc<Shared>, address: Address, title: &str) -> Result<Self> {
        let page = page::render(title, &shared.scene(), shared.commands.is_some())?;
        let shared = Arc::clone(shared);
        Self::serve(address, page, move || Box::new(run::Audience::join(&shared)))
    }

    /// Begins to serve a page; `open` gives each client what is to be told to it.
    ///
    /// # Errors
    /// When the address cannot be listened at.
    pub fn serve(
        address: Address,
        page: String,
        open: impl Fn() -> Box<dyn Teller> + Send + Sync + 'static,
    ) -> Result<Self> {
        let listener = listen(&address)?;
        let at = listener.local_addr().context("the page's address is not known")?;
        let url = format!("http://{}/{}", SocketAddr::new(reachable(at.ip()), at.port()), address.query());
        let connections = Arc::new(AtomicUsize::new(0));
        let site =
            Arc::new(Site { address, page, open: Box::new(open), connections: Arc::clone(&connections) });
        std::thread::Builder::new()
            .name("page".into())
            .spawn(move || accept(&listener, &site))
            .context("cannot start the thread that serves the page")?;
        Ok(Self { url, connections })
    }

    /// Where to open it.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Waits until all clients have got the last of it and left, but not long.
    pub fn wait_for_clients(&self) {
        let began = Instant::now();
        while self.connections.load(Ordering::Acquire) > 0 && began.elapsed() < FAREWELL {
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

/// Listens at the port given, or at the usual one, or any.
fn listen(address: &Address) -> Result<TcpListener> {
    let ip = address.ip();
    if let Some(port) = address.port {
        return TcpListener::bind((ip, port)).with_context(|| {
            format!("cannot serve a page at {ip}, port {port}\nhint: --view alone takes a free port; --bind takes an address of this machine")
        });
    }
    TcpListener::bind((ip, USUAL_PORT)).or_else(|_| TcpListener::bind((ip, 0))).with_context(|| {
        format!("cannot serve a page at {ip}\nhint: --bind takes an address of this machine")
    })
}

/// An address that others reach this machine by, where it listens at all of them.
fn reachable(ip: IpAddr) -> IpAddr {
    if !ip.is_unspecified() {
        return ip;
    }
    // Nothing is sent: the system only chooses the address it would send from.
    let chosen = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).and_then(|socket| {
        socket.connect((Ipv4Addr::new(192, 0, 2, 1), 9)).and_then(|()| socket.local_addr())
    });
    chosen.map_or(ip, |at| at.ip())
}

fn accept(listener: &TcpListener, site: &Arc<Site>) {
    for stream in listener.incoming() {
        let Ok(stream) = stream else {
            // Out of files, say: not for ever.
            std::thread::sleep(Duration::from_millis(50));
            continue;
        };
        let seat = Connection::new(site);
        if site.connections.load(Ordering::Acquire) > MAX_CONNECTIONS {
            continue;
        }
        // Without a thread the client is refused, as when there are too many.
        let _ = std::thread::Builder::new().name("page client".into()).spawn(move || {
            // Errors are the client's leaving.
            let _ = seat.0.answer(stream);
        });
    }
}

/// Counted while it lives.
struct Connection(Arc<Site>);

impl Connection {
    fn new(site: &Arc<Site>) -> Self {
        site.connections.fetch_add(1, Ordering::AcqRel);
        Self(Arc::clone(site))
    }
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.0.connections.fetch_sub(1, Ordering::AcqRel);
    }
}

impl Site {
    fn answer(&self, mut stream: TcpStream) -> std::io::Result<()> {
        stream.set_read_timeout(Some(READ_PATIENCE))?;
        stream.set_write_timeout(Some(READ_PATIENCE))?;
        let request = Request::read(&mut stream)?;
        if let Err(reason) = self.address.admit(&request.visit()) {
            std::thread::sleep(REFUSAL_DELAY);
            return http::answer(&mut stream, "403 Forbidden", "text/plain", reason.as_bytes());
        }
        match (&*request.method, &*request.path, &request.websocket_key) {
            ("GET", "/ws", Some(key)) => {
                http::upgrade(&mut stream, key)?;
                client::serve(stream, &mut *(self.open)());
                Ok(())
            }
            ("GET", "/", _) => http::answer(&mut stream, "200 OK", "text/html", self.page.as_bytes()),
            ("GET", ..) => {
                http::answer(&mut stream, "404 Not Found", "text/plain", b"there is only one page: /")
            }
            _ => http::answer(&mut stream, "405 Method Not Allowed", "text/plain", b"only GET"),
        }
    }
}
