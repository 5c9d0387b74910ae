//! TCP connections: with TLS between peers that have keys, wherever they are, and plain within one machine, for
//! demonstrations and tests, and for programs on one robot.
//!
//! On a plain one nothing is encrypted and nobody proves who he is, so neither end is ever another machine's.

use super::Transport;
use super::congestion::prefer_bbr;
use super::endpoint::Endpoint;
use super::stream::Stream;
use super::tls::{Side, Tls, disconnect_reason};
use crate::keys::{Keys, Peer};
use crate::node::{Event, LinkId};
use crate::wire::{MAX_MESSAGE, Priority};
use anyhow::{Context, Result, bail};
use std::collections::BTreeMap;
use std::net::{IpAddr, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Links at once: some hundred agents and some that are being replaced. Each has two threads.
const MOST_LINKS: usize = 1024;
/// Connections at once of whom it is not known yet who they are, in all and from one address.
const MOST_UNKNOWN: usize = 64;
const MOST_UNKNOWN_OF_ONE: usize = 16;
/// How long dialling may take.
const PATIENCE: Duration = Duration::from_secs(2);
/// How long one waits before dialling again, at first and at most.
const REDIAL: [Duration; 2] = [Duration::from_millis(250), Duration::from_secs(4)];
/// How often threads look whether they are to end.
const LOOK: Duration = Duration::from_millis(100);

/// Links to other programs.
pub struct Tcp {
    shared: Arc<Shared>,
    /// Where it listens, with the port that it got.
    listening: Option<Endpoint>,
}

struct Shared {
    tls: Option<Tls>,
    links: Mutex<BTreeMap<LinkId, Arc<Stream>>>,
    /// How many connections of each address are not links yet.
    unknown: Mutex<BTreeMap<IpAddr, usize>>,
    next: AtomicU64,
    events: Sender<Event>,
    ends: AtomicBool,
}

impl Tcp {
    /// Listens at `listen` and dials `dial`, again and again where nobody answers or a link ends. With keys all of it is
    /// TLS.
    ///
    /// # Errors
    /// When a plain address is not of this machine alone, TLS is wanted without keys or the reverse, or an address
    /// cannot be listened at.
    pub fn start(
        listen: Option<&Endpoint>,
        dial: &[Endpoint],
        keys: Option<&Keys>,
        events: Sender<Event>,
    ) -> Result<Self> {
        listen.into_iter().chain(dial).try_for_each(|endpoint| check(endpoint, keys))?;
        let shared = Arc::new(Shared {
            tls: keys.map(Tls::new).transpose()?,
            links: Mutex::default(),
            unknown: Mutex::default(),
            next: AtomicU64::new(1),
            events,
            ends: AtomicBool::new(false),
        });
        let mut listening = None;
        if let Some(endpoint) = listen {
            let what = || format!("{endpoint} cannot be listened at");
            let listener = TcpListener::bind(&endpoint.resolve()?[..]).with_context(what)?;
            listener.set_nonblocking(true)?;
            listening = Some(endpoint.at_port(listener.local_addr()?.port()));
            let shared = Arc::clone(&shared);
            thread::Builder::new().name("fleet-listen".into()).spawn(move || accept(&shared, &listener))?;
        }
        for endpoint in dial {
            let (shared, endpoint) = (Arc::clone(&shared), endpoint.clone());
            thread::Builder::new().name("fleet-dial".into()).spawn(move || redial(&shared, &endpoint))?;
        }
        Ok(Self { shared, listening })
    }

    /// Where it listens.
    pub fn listening(&self) -> Option<&Endpoint> {
        self.listening.as_ref()
    }

    /// The congestion control of each link.
    #[cfg(all(test, target_os = "linux"))]
    pub fn congestion(&self) -> Vec<String> {
        let of = |stream: &Arc<Stream>| rustix::net::sockopt::tcp_congestion(&stream.socket).unwrap();
        self.shared.links().values().map(of).collect()
    }
}

/// Whether one may listen there or dial it.
fn check(endpoint: &Endpoint, keys: Option<&Keys>) -> Result<()> {
    match (endpoint.secure, keys) {
        (true, Some(_)) => Ok(()),
        (true, None) => bail!(
            "{endpoint} needs keys: --keys DIR\nhint: `loopbox keys init AUTHORITY` makes an authority, `loopbox keys \
             agent NAME --authority AUTHORITY --out DIR` the keys of a machine"
        ),
        (false, Some(_)) => bail!(
            "{endpoint} is not encrypted and nobody proves there who he is: with --keys all goes by TLS\nhint: \
             tls/{}:{}",
            endpoint.host,
            endpoint.port
        ),
        (false, None) => match endpoint.resolve()?.iter().find(|address| !address.ip().is_loopback()) {
            Some(_) => bail!(
                "{endpoint} is not of this machine alone, and without keys nothing goes beyond it: anyone could read and \
                 write along\nhint: tls/{}:{} with --keys DIR (`loopbox keys`), or tcp/127.0.0.1:{} within this machine",
                endpoint.host,
                endpoint.port,
                endpoint.port
            ),
            None => Ok(()),
        },
    }
}

impl Transport for Tcp {
    fn send(&self, link: LinkId, priority: Priority, bytes: Vec<u8>) {
        if let Some(stream) = self.shared.links().get(&link) {
            stream.queue.push(priority, bytes);
        }
    }

    fn looked_at(&self, link: LinkId, bytes: usize) {
        if let Some(stream) = self.shared.links().get(&link) {
            stream.backlog.remove(bytes);
        }
    }

    fn close(&self, link: LinkId) {
        if let Some(stream) = self.shared.links().get(&link) {
            stream.queue.close();
        }
    }
}

impl Drop for Tcp {
    fn drop(&mut self) {
        self.shared.ends.store(true, Ordering::Relaxed);
        self.shared.links().values().for_each(|stream| stream.queue.close());
    }
}

impl Shared {
    fn links(&self) -> MutexGuard<'_, BTreeMap<LinkId, Arc<Stream>>> {
        // Every section leaves it whole.
        self.links.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn unknown(&self) -> MutexGuard<'_, BTreeMap<IpAddr, usize>> {
        // Every section leaves it whole.
        self.unknown.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn ends(&self) -> bool {
        self.ends.load(Ordering::Relaxed)
    }

    /// Whether there is room for one more connection from there, which is counted then.
    fn admit(&self, from: IpAddr) -> bool {
        let links = self.links().len();
        let mut unknown = self.unknown();
        let all: usize = unknown.values().sum();
        let of_one = unknown.get(&from).copied().unwrap_or(0);
        let has_room = links + all < MOST_LINKS && all < MOST_UNKNOWN && of_one < MOST_UNKNOWN_OF_ONE;
        if has_room {
            unknown.insert(from, of_one + 1);
        }
        has_room
    }

    /// It is known who a connection from there is, or there will be none.
    fn release(&self, from: IpAddr) {
        let mut unknown = self.unknown();
        match unknown.get_mut(&from) {
            Some(count) if *count > 1 => *count -= 1,
            _ => drop(unknown.remove(&from)),
        }
    }

    /// Why a connection did not come about or broke; without anyone to tell, the program ends.
    fn trouble(&self, text: Option<String>) {
        if let Some(text) = text {
            let _ = self.events.send(Event::Trouble(text));
        }
    }

    /// Why nobody answers where it was dialled.
    fn unanswered(&self, address: &str, reason: String) {
        let _ = self.events.send(Event::Unanswered { address: address.to_owned(), reason });
    }

    /// Takes a connection that came.
    fn accept(self: &Arc<Self>, socket: TcpStream, from: SocketAddr) {
        // Its port is another one each time, and says nothing to people.
        let kind = if self.tls.is_some() { "tls" } else { "tcp" };
        let place = format!("{kind}/{}", from.ip());
        let opened = self.open(&socket, Side::Accepted);
        self.release(from.ip());
        match opened {
            Ok((stream, peer)) => self.serve(stream, peer, &place, &format!("{kind}/{from}")),
            Err(error) => self.trouble(disconnect_reason(&place, &error)),
        }
    }

    /// Makes a connection one that messages can go over, and finds out who is at the other end.
    fn open(&self, socket: &TcpStream, side: Side) -> std::io::Result<(Stream, Option<Peer>)> {
        socket.set_nodelay(true)?;
        prefer_bbr(socket);
        socket.set_nonblocking(false)?;
        socket.set_write_timeout(Some(LOOK))?;
        socket.set_read_timeout(Some(LOOK))?;
        let Some(tls) = &self.tls else { return Ok((Stream::new(socket.try_clone()?, None), None)) };
        let (session, peer) = tls.shake(socket, side, || self.ends())?;
        Ok((Stream::new(socket.try_clone()?, Some(session)), Some(peer)))
    }

    /// Carries messages on a connection until it ends.
    fn serve(self: &Arc<Self>, stream: Stream, peer: Option<Peer>, place: &str, address: &str) {
        let stream = Arc::new(stream);
        let link = self.next.fetch_add(1, Ordering::Relaxed);
        let of_writer = Arc::clone(&stream);
        let writer = thread::Builder::new().name("fleet-send".into()).spawn(move || of_writer.write_all());
        // Without a thread the connection is dropped, and dialled again.
        let Ok(writer) = writer else { return };
        self.links().insert(link, Arc::clone(&stream));
        // Without anyone to tell, the program ends.
        let _ = self.events.send(Event::Up { link, address: address.to_owned(), peer });
        let mut reader = stream.reader();
        let ended = loop {
            if !stream.backlog.has_room(LOOK) {
                if stream.queue.is_closing() {
                    break None;
                }
                continue;
            }
            match reader.message() {
                Ok(Some(bytes)) => {
                    let is_too_long = bytes.len() > MAX_MESSAGE;
                    stream.backlog.add(bytes.len());
                    if self.events.send(Event::Received { link, bytes }).is_err() || is_too_long {
                        break None;
                    }
                }
                Ok(None) => break None,
                Err(error) => break disconnect_reason(place, &error),
            }
        };
        stream.queue.close();
        let _ = writer.join();
        self.links().remove(&link);
        self.trouble(ended);
        let _ = self.events.send(Event::Down { link });
    }
}

/// Takes connections until the end.
fn accept(shared: &Arc<Shared>, listener: &TcpListener) {
    while !shared.ends() {
        match listener.accept() {
            Ok((socket, from)) if shared.admit(from.ip()) => {
                let of_thread = Arc::clone(shared);
                let work = move || of_thread.accept(socket, from);
                if thread::Builder::new().name("fleet-receive".into()).spawn(work).is_err() {
                    shared.release(from.ip());
                }
            }
            Ok(_) => {}
            Err(_) => thread::sleep(LOOK),
        }
    }
}

/// Dials once.
fn dial(endpoint: &Endpoint) -> std::result::Result<TcpStream, String> {
    let addresses = endpoint.resolve().map_err(|error| format!("{error:#}"))?;
    // A name without TLS may have come to be another machine's.
    let may = |address: &&SocketAddr| endpoint.secure || address.ip().is_loopback();
    let mut reason = "it has no address that may be dialled".to_owned();
    for address in addresses.iter().filter(may) {
        match TcpStream::connect_timeout(address, PATIENCE) {
            Ok(socket) => return Ok(socket),
            Err(error) => reason = error.to_string(),
        }
    }
    Err(reason)
}

/// Dials until the end.
fn redial(shared: &Arc<Shared>, endpoint: &Endpoint) {
    let (mut pause, place) = (REDIAL[0], endpoint.to_string());
    while !shared.ends() {
        match dial(endpoint) {
            Ok(socket) => {
                let since = Instant::now();
                match shared.open(&socket, Side::Dialled) {
                    Ok((stream, peer)) => shared.serve(stream, peer, &place, &place),
                    Err(error) => {
                        shared.trouble(disconnect_reason(&place, &error));
                        shared.unanswered(&place, error.to_string());
                    }
                }
                if since.elapsed() > PATIENCE {
                    pause = REDIAL[0];
                }
            }
            Err(reason) => shared.unanswered(&place, reason),
        }
        let until = Instant::now() + pause;
        while Instant::now() < until && !shared.ends() {
            thread::sleep(LOOK.min(pause));
        }
        pause = (pause * 2).min(REDIAL[1]);
    }
}
