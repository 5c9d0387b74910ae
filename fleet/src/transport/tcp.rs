//! Plain TCP within one machine: for demonstrations and tests, and for programs on one robot. A message is its length
//! (four bytes, little-endian) and its bytes.
//!
//! Nothing is encrypted and nobody proves who he is, so neither end is ever another machine's.

use super::Transport;
use super::queue::Queue;
use crate::node::{Event, LinkId};
use crate::wire::{MAX_MESSAGE, Priority};
use std::collections::BTreeMap;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Links at once: a hundred agents and some that are being replaced.
const MOST_LINKS: usize = 256;
/// How long dialling and the flushing of what is left may take.
const PATIENCE: Duration = Duration::from_secs(2);
/// How long one waits before dialling again, at first and at most.
const REDIAL: [Duration; 2] = [Duration::from_millis(250), Duration::from_secs(4)];
/// How often threads look whether they are to end.
const LOOK: Duration = Duration::from_millis(100);

/// Links to other programs on this machine.
pub struct Tcp {
    shared: Arc<Shared>,
    /// Where it listens, with the port that it got.
    listening: Option<SocketAddr>,
}

struct Shared {
    links: Mutex<BTreeMap<LinkId, Arc<Connection>>>,
    next: AtomicU64,
    events: Sender<Event>,
    ends: AtomicBool,
}

struct Connection {
    stream: TcpStream,
    queue: Queue,
}

impl Tcp {
    /// Listens at `listen` and dials `dial`, again and again where nobody answers or a link ends.
    ///
    /// # Errors
    /// When an address is not of this machine alone, or cannot be listened at.
    pub fn start(listen: Option<SocketAddr>, dial: &[SocketAddr], events: Sender<Event>) -> io::Result<Self> {
        if let Some(foreign) = listen.iter().chain(dial).find(|address| !address.ip().is_loopback()) {
            let what = format!(
                "tcp/{foreign} is not of this machine alone, and without keys nothing goes beyond it: anyone could read \
                 and write along\nhint: tcp/127.0.0.1:{} stays within this machine",
                foreign.port()
            );
            return Err(io::Error::new(ErrorKind::PermissionDenied, what));
        }
        let shared = Arc::new(Shared {
            links: Mutex::default(),
            next: AtomicU64::new(1),
            events,
            ends: AtomicBool::new(false),
        });
        let mut listening = None;
        if let Some(address) = listen {
            let listener = TcpListener::bind(address).map_err(|error| {
                io::Error::new(error.kind(), format!("tcp/{address} cannot be listened at: {error}"))
            })?;
            listener.set_nonblocking(true)?;
            listening = Some(listener.local_addr()?);
            let shared = Arc::clone(&shared);
            thread::Builder::new().name("fleet-listen".into()).spawn(move || accept(&shared, &listener))?;
        }
        for address in dial {
            let (shared, address) = (Arc::clone(&shared), *address);
            thread::Builder::new().name("fleet-dial".into()).spawn(move || redial(&shared, address))?;
        }
        Ok(Self { shared, listening })
    }

    /// Where it listens.
    pub fn listening(&self) -> Option<SocketAddr> {
        self.listening
    }
}

impl Transport for Tcp {
    fn send(&self, link: LinkId, priority: Priority, bytes: Vec<u8>) {
        if let Some(connection) = self.shared.links().get(&link) {
            connection.queue.push(priority, bytes);
        }
    }

    fn close(&self, link: LinkId) {
        if let Some(connection) = self.shared.links().get(&link) {
            connection.queue.close();
        }
    }
}

impl Drop for Tcp {
    fn drop(&mut self) {
        self.shared.ends.store(true, Ordering::Relaxed);
        self.shared.links().values().for_each(|connection| connection.queue.close());
    }
}

impl Shared {
    fn links(&self) -> std::sync::MutexGuard<'_, BTreeMap<LinkId, Arc<Connection>>> {
        // Every section leaves it whole.
        self.links.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn ends(&self) -> bool {
        self.ends.load(Ordering::Relaxed)
    }

    /// Carries messages on a connection until it ends.
    fn serve(self: &Arc<Self>, stream: TcpStream, address: SocketAddr) -> io::Result<()> {
        stream.set_nodelay(true)?;
        stream.set_nonblocking(false)?;
        stream.set_write_timeout(Some(LOOK))?;
        stream.set_read_timeout(Some(LOOK))?;
        let mut reader = stream.try_clone()?;
        let connection = Arc::new(Connection { stream, queue: Queue::default() });
        let link = self.next.fetch_add(1, Ordering::Relaxed);
        self.links().insert(link, Arc::clone(&connection));
        let of_writer = Arc::clone(&connection);
        let writer = thread::Builder::new().name("fleet-send".into()).spawn(move || {
            write_all(&of_writer);
            let _ = of_writer.stream.shutdown(Shutdown::Both);
        })?;
        // Without anyone to tell, the program ends.
        let _ = self.events.send(Event::Up { link, address: format!("tcp/{address}") });
        while let Ok(Some(bytes)) = read_message(&mut reader, &connection.queue) {
            let is_too_long = bytes.len() > MAX_MESSAGE;
            if self.events.send(Event::Received { link, bytes }).is_err() || is_too_long {
                break;
            }
        }
        connection.queue.close();
        let _ = writer.join();
        self.links().remove(&link);
        let _ = self.events.send(Event::Down { link });
        Ok(())
    }
}

/// Takes connections until the end.
fn accept(shared: &Arc<Shared>, listener: &TcpListener) {
    while !shared.ends() {
        match listener.accept() {
            Ok((stream, address)) if shared.links().len() < MOST_LINKS => {
                let shared = Arc::clone(shared);
                let serve = move || drop(shared.serve(stream, address));
                // Without a thread the connection is dropped, and dialled again.
                let _ = thread::Builder::new().name("fleet-receive".into()).spawn(serve);
            }
            Ok(_) => {}
            Err(_) => thread::sleep(LOOK),
        }
    }
}

/// Dials until the end.
fn redial(shared: &Arc<Shared>, address: SocketAddr) {
    let mut pause = REDIAL[0];
    while !shared.ends() {
        if let Ok(stream) = TcpStream::connect_timeout(&address, PATIENCE) {
            let since = Instant::now();
            let _ = shared.serve(stream, address);
            if since.elapsed() > PATIENCE {
                pause = REDIAL[0];
            }
        }
        let until = Instant::now() + pause;
        while Instant::now() < until && !shared.ends() {
            thread::sleep(LOOK.min(pause));
        }
        pause = (pause * 2).min(REDIAL[1]);
    }
}

/// The next message; `None` when the connection is to be closed. Of one that is too long only so much that it shows.
fn read_message(stream: &mut TcpStream, queue: &Queue) -> io::Result<Option<Vec<u8>>> {
    let mut length = [0; 4];
    if !read_all(stream, &mut length, queue)? {
        return Ok(None);
    }
    let length = (u32::from_le_bytes(length) as usize).min(MAX_MESSAGE + 1);
    let mut bytes = vec![0; length];
    if length <= MAX_MESSAGE && !read_all(stream, &mut bytes, queue)? {
        return Ok(None);
    }
    Ok(Some(bytes))
}

/// Fills `bytes`; false when the connection is to be closed before.
fn read_all(stream: &mut TcpStream, mut bytes: &mut [u8], queue: &Queue) -> io::Result<bool> {
    while !bytes.is_empty() {
        match stream.read(bytes) {
            Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
            Ok(count) => bytes = &mut bytes[count..],
            Err(error) if is_patience(&error) && !queue.is_closing() => {}
            Err(error) if is_patience(&error) => return Ok(false),
            Err(error) => return Err(error),
        }
    }
    Ok(true)
}

/// Sends what waits until the link is closed.
fn write_all(connection: &Connection) {
    let mut closing_since = None;
    while let Some(message) = connection.queue.pop() {
        let mut framed = (message.len() as u32).to_le_bytes().to_vec();
        framed.extend(message);
        let mut rest = &framed[..];
        while !rest.is_empty() {
            match (&connection.stream).write(rest) {
                Ok(count) => rest = &rest[count..],
                Err(error) if is_patience(&error) => {
                    let closing = connection.queue.is_closing();
                    let since = closing.then(|| *closing_since.get_or_insert_with(Instant::now));
                    if since.is_some_and(|since| since.elapsed() > PATIENCE) {
                        return;
                    }
                }
                Err(_) => return connection.queue.close(),
            }
        }
    }
}

/// Whether only time has passed.
fn is_patience(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted)
}
