//! A client of the page's server.

use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};
use tungstenite::{Message, WebSocket};

/// Nothing that is waited for takes so long, even on a machine that is busy with other things.
pub const PATIENCE: Duration = Duration::from_secs(300);

/// The kind of a message that holds an image.
const PICTURE: u8 = 4;

/// What a page holds.
pub struct Client {
    socket: WebSocket<TcpStream>,
    /// The newest numbers.
    pub status: Value,
    /// Whether it answers the marks of rounds, as a page does that has taken them in.
    pub answers: bool,
    /// How many rounds came.
    pub rounds: u64,
    /// How many binary messages came, by kind.
    pub counts: [usize; 6],
    /// Depths over the newest image.
    pub depths: u32,
    /// How often everything began anew.
    pub resets: usize,
    /// The connection was closed by the server.
    pub closed: bool,
}

/// `host:port` of an address.
pub fn host(url: &str) -> &str {
    url.trim_start_matches("http://").split('/').next().expect("a host")
}

impl Client {
    /// Connects to what is served at `url`.
    pub fn connect(url: &str) -> Self {
        let stream = TcpStream::connect(host(url)).expect("it listens");
        let query = url.split_once('?').map_or(String::new(), |(_, query)| format!("?{query}"));
        let (socket, _) =
            tungstenite::client(format!("ws://{}/ws{query}", host(url)), stream).expect("it agrees");
        socket
            .get_ref()
            .set_read_timeout(Some(Duration::from_millis(100)))
            .expect("a socket takes a timeout");
        Self {
            socket,
            status: Value::Null,
            answers: true,
            rounds: 0,
            counts: [0; 6],
            depths: 0,
            resets: 0,
            closed: false,
        }
    }

    /// Sends a command.
    pub fn command(&mut self, command: &str) {
        let text = json!({ "command": command }).to_string();
        self.socket.send(Message::text(text)).expect("it is taken");
    }

    /// Begins or ends recording.
    pub fn record(&mut self, on: bool) {
        let text = json!({ "command": "record", "on": on }).to_string();
        self.socket.send(Message::text(text)).expect("it is taken");
    }

    /// Takes what comes until `done`.
    pub fn until(&mut self, what: &str, done: impl Fn(&Self) -> bool) {
        let began = Instant::now();
        while !done(self) {
            assert!(
                began.elapsed() < PATIENCE,
                "in vain waited for: {what}; the last numbers: {}",
                self.status
            );
            assert!(!self.closed, "closed before: {what}; the last numbers: {}", self.status);
            self.take();
        }
    }

    /// Takes what comes for so long.
    pub fn during(&mut self, time: Duration) {
        let began = Instant::now();
        while began.elapsed() < time && !self.closed {
            self.take();
        }
    }

    fn take(&mut self) {
        match self.socket.read() {
            Ok(Message::Text(text)) => {
                let message: Value = serde_json::from_str(&text).expect("JSON");
                match message["kind"].as_str() {
                    Some("status") => self.status = message["status"].clone(),
                    Some("reset") => self.resets += 1,
                    Some("round") => self.answer(&message["round"]),
                    _ => {}
                }
            }
            Ok(Message::Binary(bytes)) => {
                self.counts[usize::from(bytes[0])] += 1;
                if bytes[0] == PICTURE {
                    self.depths = u32::from_le_bytes([16, 17, 18, 19].map(|i| bytes[i]));
                }
            }
            Ok(Message::Close(_)) => self.closed = true,
            Ok(_) => {}
            Err(tungstenite::Error::Io(error)) if error.kind() == std::io::ErrorKind::WouldBlock => {}
            Err(_) => self.closed = true,
        }
    }

    fn answer(&mut self, round: &Value) {
        self.rounds += 1;
        if self.answers {
            // The end of the conversation may have come first.
            let _ = self.socket.send(Message::text(json!({ "answer": round }).to_string()));
        }
    }

    /// A number of the status.
    pub fn number(&self, name: &str) -> u64 {
        self.status[name].as_u64().unwrap_or_default()
    }

    /// A text of the status.
    pub fn text(&self, name: &str) -> &str {
        self.status[name].as_str().unwrap_or_default()
    }
}

/// The answer to a request with these headers: its first line, and all of it.
pub fn request(host: &str, path: &str, headers: &[(&str, &str)]) -> (String, String) {
    let mut stream = TcpStream::connect(host).expect("it listens");
    let mut head = format!("GET {path} HTTP/1.1\r\n");
    for (name, value) in headers {
        head += &format!("{name}: {value}\r\n");
    }
    stream.write_all(format!("{head}\r\n").as_bytes()).expect("it is taken");
    stream.set_read_timeout(Some(Duration::from_secs(5))).expect("a socket takes a timeout");
    let mut answer = Vec::new();
    let mut piece = [0; 4096];
    // An agreement to speak WebSocket is not followed by an end.
    while let Ok(count @ 1..) = stream.read(&mut piece) {
        answer.extend_from_slice(&piece[..count]);
        if answer.starts_with(b"HTTP/1.1 101") {
            break;
        }
    }
    let text = String::from_utf8_lossy(&answer).into_owned();
    (text.lines().next().unwrap_or_default().to_owned(), text)
}

/// What asks for a WebSocket.
pub const UPGRADE: [(&str, &str); 4] = [
    ("Connection", "Upgrade"),
    ("Upgrade", "websocket"),
    ("Sec-WebSocket-Version", "13"),
    ("Sec-WebSocket-Key", "dGhlIHNhbXBsZSBub25jZQ=="),
];
