//! Messages on a connection, with TLS or without: each is its length (four bytes, little-endian) and its bytes.

use super::backlog::Backlog;
use super::is_patience;
use super::queue::Queue;
use super::tls::broken;
use crate::wire::MAX_MESSAGE;
use rustls::Connection;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// How long the flushing of what is left may take.
const PATIENCE: Duration = Duration::from_secs(2);

/// A connection and what waits to be sent on it. One thread reads it, another one writes.
pub(super) struct Stream {
    pub socket: TcpStream,
    session: Option<Mutex<Connection>>,
    pub queue: Queue,
    pub backlog: Backlog,
}

impl Stream {
    pub fn new(socket: TcpStream, session: Option<Connection>) -> Self {
        Self {
            socket,
            session: session.map(Mutex::new),
            queue: Queue::default(),
            backlog: Backlog::default(),
        }
    }

    /// What reads it.
    pub fn reader(&self) -> Reader<'_> {
        Reader { stream: self, opened: Vec::new(), read: 0 }
    }

    /// Sends what waits until the link is closed, and closes it.
    pub fn write_all(&self) {
        let mut closing_since = None;
        while let Some(message) = self.queue.pop() {
            let Ok(sealed) = self.sealed(&message) else { break };
            let mut rest = &sealed[..];
            while !rest.is_empty() {
                match (&self.socket).write(rest) {
                    Ok(count) => rest = &rest[count..],
                    Err(error) if is_patience(&error) => {
                        let since =
                            self.queue.is_closing().then(|| *closing_since.get_or_insert_with(Instant::now));
                        if since.is_some_and(|since| since.elapsed() > PATIENCE) {
                            return self.end();
                        }
                    }
                    Err(_) => return self.end(),
                }
            }
        }
        self.end();
    }

    fn end(&self) {
        self.queue.close();
        // It may be closed already.
        let _ = self.socket.shutdown(Shutdown::Both);
    }

    /// A message as it goes over the connection. Only the thread that writes calls it: what is sealed first is sent
    /// first.
    fn sealed(&self, message: &[u8]) -> io::Result<Vec<u8>> {
        let mut framed = (message.len() as u32).to_le_bytes().to_vec();
        framed.extend(message);
        let Some(session) = &self.session else { return Ok(framed) };
        let mut session = locked(session);
        let (mut sealed, mut rest) = (Vec::with_capacity(framed.len() + 128), &framed[..]);
        while !rest.is_empty() || session.wants_write() {
            let taken = session.writer().write(rest)?;
            rest = &rest[taken..];
            while session.wants_write() {
                session.write_tls(&mut sealed)?;
            }
        }
        Ok(sealed)
    }
}

/// Reads a connection.
pub(super) struct Reader<'a> {
    stream: &'a Stream,
    /// What TLS opened and is not read yet.
    opened: Vec<u8>,
    read: usize,
}

impl Reader<'_> {
    /// The next message; `None` when the connection is to be closed. Of one that is too long only so much that it shows.
    ///
    /// # Errors
    /// When the connection broke.
    pub fn message(&mut self) -> io::Result<Option<Vec<u8>>> {
        let mut length = [0; 4];
        if !self.fill(&mut length)? {
            return Ok(None);
        }
        // What TLS says when something is wrong begins so (RFC 8446, §5.1): as a length too long for a message.
        if self.stream.session.is_none() && matches!(length, [21, 3, 1..=4, 0]) {
            let what = "it speaks TLS: dial tls/ instead of tcp/, with keys";
            return Err(io::Error::new(ErrorKind::InvalidData, what));
        }
        let length = (u32::from_le_bytes(length) as usize).min(MAX_MESSAGE + 1);
        let mut bytes = vec![0; length];
        if length <= MAX_MESSAGE && !self.fill(&mut bytes)? {
            return Ok(None);
        }
        Ok(Some(bytes))
    }

    /// Fills `bytes`; false when the connection is to be closed before.
    fn fill(&mut self, mut bytes: &mut [u8]) -> io::Result<bool> {
        while !bytes.is_empty() {
            match self.some(bytes) {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(count) => bytes = &mut bytes[count..],
                Err(error) if is_patience(&error) && !self.stream.queue.is_closing() => {}
                Err(error) if is_patience(&error) => return Ok(false),
                Err(error) => return Err(error),
            }
        }
        Ok(true)
    }

    /// Reads what there is, at least a byte unless the other end is done.
    fn some(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let Some(session) = &self.stream.session else { return (&self.stream.socket).read(bytes) };
        while self.read == self.opened.len() {
            self.opened.clear();
            self.read = 0;
            // What came with the end of the handshake is there already.
            if !read_opened(&mut locked(session), &mut self.opened)? && self.opened.is_empty() {
                return Ok(0);
            }
            if !self.opened.is_empty() {
                break;
            }
            let mut raw = [0; 16 << 10];
            let count = (&self.stream.socket).read(&mut raw)?;
            if count == 0 {
                return Ok(0);
            }
            let (mut raw, mut session) = (&raw[..count], locked(session));
            while !raw.is_empty() {
                session.read_tls(&mut raw)?;
                session.process_new_packets().map_err(broken)?;
                read_opened(&mut session, &mut self.opened)?;
            }
        }
        let count = bytes.len().min(self.opened.len() - self.read);
        bytes[..count].copy_from_slice(&self.opened[self.read..self.read + count]);
        self.read += count;
        Ok(count)
    }
}

/// Reads what is decrypted; false when the other end is done.
fn read_opened(session: &mut Connection, into: &mut Vec<u8>) -> io::Result<bool> {
    let mut some = [0; 16 << 10];
    loop {
        match session.reader().read(&mut some) {
            Ok(0) => return Ok(false),
            Ok(count) => into.extend(&some[..count]),
            Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(true),
            Err(error) => return Err(error),
        }
    }
}

fn locked(session: &Mutex<Connection>) -> MutexGuard<'_, Connection> {
    // A session that broke says so when it is used next.
    session.lock().unwrap_or_else(PoisonError::into_inner)
}
