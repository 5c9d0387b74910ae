//! The page in the browser: one HTML page and a WebSocket for it, a thread for each client.

pub(super) mod access;
mod client;
mod encode;
pub(super) mod http;
mod metrics;
mod page;
mod room;
mod run;
#[cfg(test)]
mod tests;

pub use access::Address;
pub use client::PageSession;
pub use encode::picture as picture_message;
pub use tungstenite::Message;

use super::{Shared, Status};
use crate::report::page::policy_of;
use crate::report::script::Script;
use crate::script;
use access::Visit;
use anyhow::{Context, Result};
use http::Request;
use page::Mode;
use room::{Room, Waiting};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// The scripts with which a page takes in what it is sent.
pub const FEED_SCRIPTS: [Script; 2] = [script!("../assets/decode.js"), script!("../assets/feed.js")];

/// The port where none is given and it is free.
pub const USUAL_PORT: u16 = 7171;
/// Every wait for a request's head ends after this.
const READ_PATIENCE: Duration = Duration::from_secs(3);
/// How long an end waits for pages to get the last of it.
const FAREWELL: Duration = Duration::from_secs(2);
const UNAVAILABLE: &str = "503 Service Unavailable";
const NOT_FOUND: &str = "404 Not Found";
/// Guesses at a token are slowed down by this.
const REFUSAL_DELAY: Duration = Duration::from_millis(200);

/// What `/health` says: whether all is well, and how things are as JSON.
pub type Health = Box<dyn Fn() -> (bool, String) + Send + Sync>;

/// A page being served, by threads that end with the process. Clones are one.
#[derive(Clone)]
pub struct Server {
    url: String,
    site: Arc<Site>,
}

/// What every connection needs.
struct Site {
    address: Address,
    /// What there is to see at the moment.
    served: Mutex<Option<Arc<ServedPage>>>,
    health: Option<Health>,
    /// The report of what is shown, once it is written.
    report: Mutex<Option<PathBuf>>,
    /// What browsers keep the token as: cookies of all ports of a machine are in one place.
    cookie: String,
    room: Arc<Room>,
}

/// A page, and what gives each client what is to be told to it.
struct ServedPage {
    page: Box<dyn Fn() -> Result<String> + Send + Sync>,
    open: Box<dyn Fn() -> Box<dyn PageSession> + Send + Sync>,
    /// The scene that it shows, where it shows one.
    scene: Option<(Mode, Arc<Shared>)>,
}

impl ServedPage {
    /// A scene, with whom it shows when the page is asked for.
    fn of(shared: &Arc<Shared>, title: &str, mode: Mode) -> Self {
        let scene = Some((mode, Arc::clone(shared)));
        let (title, seen, shared) = (title.to_owned(), Arc::clone(shared), Arc::clone(shared));
        let page = move || page::render(&title, &seen.scene(), mode);
        Self { page: Box::new(page), open: Box::new(move || Box::new(run::Audience::join(&shared))), scene }
    }

    /// What is shown of a scene beside it.
    fn status(&self) -> Option<(Mode, Status)> {
        self.scene.as_ref().map(|(mode, shared)| (*mode, shared.scene().status().clone()))
    }

    /// A run that takes commands, or a scene of which nobody does.
    fn of_run(shared: &Arc<Shared>, title: &str) -> Self {
        Self::of(shared, title, if shared.commands.is_some() { Mode::Live } else { Mode::Maps })
    }
}

impl Server {
    /// Begins to serve a scene.
    ///
    /// # Errors
    /// When the address cannot be listened at.
    pub fn start(shared: &Arc<Shared>, address: Address, title: &str) -> Result<Self> {
        Self::begin(address, Some(ServedPage::of_run(shared, title)), None)
    }

    /// Begins to serve a scene of maps that somebody collects, to which agents may yet come.
    ///
    /// # Errors
    /// When the address cannot be listened at.
    pub fn of_station(shared: &Arc<Shared>, address: Address, title: &str) -> Result<Self> {
        Self::begin(address, Some(ServedPage::of(shared, title, Mode::Station)), None)
    }

    /// Begins to serve `/health`, and no page until one is [shown](Self::show).
    ///
    /// # Errors
    /// When the address cannot be listened at.
    pub fn with_health(address: Address, health: Health) -> Result<Self> {
        Self::begin(address, None, Some(health))
    }

    /// Shows a run in place of what was shown, to be looked at only.
    pub fn show(&self, shared: &Arc<Shared>, title: &str) {
        *self.site.served() = Some(Arc::new(ServedPage::of(shared, title, Mode::Service)));
    }

    /// Shows nothing any more.
    pub fn hide(&self) {
        *self.site.served() = None;
    }

    /// Begins to serve a page; `open` gives each client what is to be told to it.
    ///
    /// # Errors
    /// When the address cannot be listened at.
    pub fn serve(
        address: Address,
        page: String,
        open: impl Fn() -> Box<dyn PageSession> + Send + Sync + 'static,
    ) -> Result<Self> {
        let page = move || Ok(page.clone());
        let served = ServedPage { page: Box::new(page), open: Box::new(open), scene: None };
        Self::begin(address, Some(served), None)
    }

    fn begin(address: Address, served: Option<ServedPage>, health: Option<Health>) -> Result<Self> {
        let listener = listen(&address)?;
        let at = listener.local_addr().context("the page's address is not known")?;
        let url = format!("http://{}/{}", SocketAddr::new(reachable(at.ip()), at.port()), address.query());
        let site = Arc::new(Site {
            address,
            served: Mutex::new(served.map(Arc::new)),
            health,
            report: Mutex::default(),
            cookie: format!("loopbox-{}", at.port()),
            room: Arc::default(),
        });
        let of_thread = Arc::clone(&site);
        std::thread::Builder::new()
            .name("page".into())
            .spawn(move || accept(&listener, &of_thread))
            .context("cannot start the thread that serves the page")?;
        Ok(Self { url, site })
    }

    /// Where to open it.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Serves this report beside the page from now on.
    pub fn offer_report(&self, report: PathBuf) {
        *self.site.report.lock().unwrap_or_else(PoisonError::into_inner) = Some(report);
    }

    /// Waits until all clients have got the last of it and left, but not long.
    pub fn wait_for_clients(&self) {
        let began = Instant::now();
        while self.site.room.seated() > 0 && began.elapsed() < FAREWELL {
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
        let (Some(waiting), site) = (site.room.wait(&stream), Arc::clone(site)) else { continue };
        // Without a thread the client is refused, as when there are too many.
        let _ = std::thread::Builder::new().name("page client".into()).spawn(move || {
            // Errors are the client's leaving.
            let _ = site.answer(stream, &waiting);
        });
    }
}

impl Site {
    fn served(&self) -> std::sync::MutexGuard<'_, Option<Arc<ServedPage>>> {
        self.served.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn answer(&self, mut stream: TcpStream, waiting: &Waiting) -> std::io::Result<()> {
        stream.set_read_timeout(Some(READ_PATIENCE))?;
        stream.set_write_timeout(Some(READ_PATIENCE))?;
        let request = Request::read(&mut stream)?;
        let visit = Visit { kept_token: request.cookie(&self.cookie), ..request.visit() };
        if let Err(reason) = self.address.admit(&visit) {
            std::thread::sleep(REFUSAL_DELAY);
            return http::answer(&mut stream, "403 Forbidden", "text/plain", reason.as_bytes());
        }
        let Some(_seat) = waiting.sit() else {
            return http::answer(&mut stream, UNAVAILABLE, "text/plain", b"too many look at this already");
        };
        let served = self.served().clone();
        match (&*request.method, &*request.path, &request.websocket_key, &served, &self.health) {
            ("GET", "/health", _, _, Some(health)) => {
                let (is_well, text) = health();
                let status = if is_well { "200 OK" } else { UNAVAILABLE };
                http::answer(&mut stream, status, "application/json", text.as_bytes())
            }
            ("GET", "/metrics", ..) => match self.metrics(served.as_deref()) {
                Some(text) => http::answer(&mut stream, "200 OK", metrics::KIND, text.as_bytes()),
                None => http::answer(&mut stream, NOT_FOUND, "text/plain", b"nothing is measured here"),
            },
            ("GET", "/ws", Some(key), Some(served), _) => {
                http::upgrade(&mut stream, key)?;
                client::serve(stream, &mut *(served.open)());
                Ok(())
            }
            ("GET", "/", _, Some(served), _) => match (served.page)() {
                Ok(page) => self.answer_with_page(&mut stream, &page, request.visit().token),
                Err(error) => {
                    let text = format!("the page cannot be made: {error:#}");
                    http::answer(&mut stream, "500 Internal Server Error", "text/plain", text.as_bytes())
                }
            },
            ("GET", "/report.html", ..) => match self.report() {
                Some(report) => self.answer_with_page(&mut stream, &report, None),
                None => http::answer(&mut stream, NOT_FOUND, "text/plain", b"there is no report yet"),
            },
            ("GET", "/" | "/ws", _, None, _) => {
                let health = self.health.as_ref().map(|health| health().1).unwrap_or_default();
                http::answer(&mut stream, UNAVAILABLE, "text/html", page::without_run(&health).as_bytes())
            }
            ("GET", ..) => http::answer(&mut stream, NOT_FOUND, "text/plain", b"there is only one page: /"),
            _ => http::answer(&mut stream, "405 Method Not Allowed", "text/plain", b"only GET"),
        }
    }

    /// Answers with a page and its policy. The browser keeps the `token` that came in the page's address, so that it can leave there.
    fn answer_with_page(
        &self,
        stream: &mut TcpStream,
        page: &str,
        token: Option<&str>,
    ) -> std::io::Result<()> {
        let policy = policy_of(page)
            .map(|policy| format!("Content-Security-Policy: {policy}; frame-ancestors 'none'\r\n"));
        let cookie = token.filter(|token| self.address.is_token(token)).map(|token| {
            format!("Set-Cookie: {}={token}; Path=/; HttpOnly; SameSite=Strict\r\n", self.cookie)
        });
        let more = [policy, cookie].map(Option::unwrap_or_default).concat();
        http::answer_with(stream, "200 OK", "text/html", page.as_bytes(), &more)
    }

    /// What is known as Prometheus reads it; nothing where no scene is shown and nobody says how things are.
    fn metrics(&self, served: Option<&ServedPage>) -> Option<String> {
        let is_well = self.health.as_ref().map(|health| health().0);
        let displayed = served.and_then(ServedPage::status);
        (is_well.is_some() || displayed.is_some()).then(|| metrics::text(is_well, displayed))
    }

    /// The report of what is shown.
    fn report(&self) -> Option<String> {
        let report = self.report.lock().unwrap_or_else(PoisonError::into_inner).clone()?;
        std::fs::read_to_string(report).ok()
    }
}
