//! One page's WebSocket: what the page says comes in, updates go out, round by round.
//!
//! Every round ends with a mark that the page answers once it has taken the round in, and until then nothing more is
//! sent. So a page that is slow to draw lags one round behind, not as many as the system's buffers hold. Only the end
//! is told without waiting.

use serde::Deserialize;
use serde_json::json;
use std::io::ErrorKind;
use std::net::TcpStream;
use std::time::{Duration, Instant};
use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Error, Message, WebSocket};

/// What pages say is short; nothing longer is read.
const MAX_MESSAGE: usize = 1024;
/// How often updates are sent.
const ROUND: Duration = Duration::from_millis(40);
/// The same while more is waiting.
const BUSY_ROUND: Duration = Duration::from_millis(2);
/// A client that takes nothing for so long is given up.
const WRITE_PATIENCE: Duration = Duration::from_secs(10);
/// The same of one that does not answer; a page that was only asleep connects anew.
const ANSWER_PATIENCE: Duration = Duration::from_secs(60);
/// How long the last words may be on their way.
const FAREWELL: Duration = Duration::from_secs(2);

/// What one page is told, and who hears what it says.
pub trait PageSession {
    /// Whether nothing will be new after the next call of [`next_messages`](Self::next_messages) that leaves nothing over.
    fn is_over(&self) -> bool;
    /// What is new since the last call, and whether more of it is waiting.
    fn next_messages(&mut self) -> (Vec<Message>, bool);
    /// Takes what the page says.
    fn receive(&mut self, text: &str);
}

/// Serves a client until it leaves, is too slow, or nothing more will change and it knows all.
pub fn serve(stream: TcpStream, session: &mut dyn PageSession) {
    let config = WebSocketConfig::default()
        .max_message_size(Some(MAX_MESSAGE))
        .max_frame_size(Some(MAX_MESSAGE))
        .read_buffer_size(MAX_MESSAGE);
    if stream.set_nodelay(true).is_err() || stream.set_write_timeout(Some(WRITE_PATIENCE)).is_err() {
        return;
    }
    let mut socket = WebSocket::from_raw_socket(stream, Role::Server, Some(config));
    // An error is the client's leaving, by which nothing is lost.
    let _ = talk(&mut socket, session);
}

/// Rounds sent, and the last one that the page has taken in.
struct Rounds {
    sent: u64,
    answered: u64,
    since: Instant,
}

/// The page's answer to a round's mark.
#[derive(Deserialize)]
struct Answer {
    answer: u64,
}

fn talk(socket: &mut WebSocket<TcpStream>, session: &mut dyn PageSession) -> Result<(), Error> {
    let mut rounds = Rounds { sent: 0, answered: 0, since: Instant::now() };
    let (mut more, mut end_sent) = (false, false);
    loop {
        let over = session.is_over();
        let waiting = rounds.answered < rounds.sent;
        if !waiting || (over && !end_sent) {
            end_sent |= over;
            more = send_round(socket, session, &mut rounds)?;
            if over && !more {
                return part(socket);
            }
        } else if rounds.since.elapsed() > ANSWER_PATIENCE {
            return Ok(());
        }
        let patience = if more { BUSY_ROUND } else { ROUND };
        if let Some(text) = listen(socket, patience)? {
            match serde_json::from_str::<Answer>(&text) {
                Ok(Answer { answer }) => rounds.answered = answer,
                Err(_) => session.receive(&text),
            }
        }
    }
}

/// Sends a round, if something is new; says whether more is waiting.
fn send_round(
    socket: &mut WebSocket<TcpStream>,
    session: &mut dyn PageSession,
    rounds: &mut Rounds,
) -> Result<bool, Error> {
    let (messages, more) = session.next_messages();
    if messages.is_empty() {
        return Ok(more);
    }
    for message in messages {
        socket.write(message)?;
    }
    rounds.sent += 1;
    rounds.since = Instant::now();
    socket.write(Message::text(json!({ "kind": "round", "round": rounds.sent }).to_string()))?;
    socket.flush()?;
    Ok(more)
}

/// Takes one message of text if one comes in time.
fn listen(socket: &mut WebSocket<TcpStream>, patience: Duration) -> Result<Option<String>, Error> {
    socket.get_ref().set_read_timeout(Some(patience))?;
    match socket.read() {
        Ok(Message::Text(text)) => Ok(Some(text.as_str().to_owned())),
        Ok(_) => Ok(None),
        Err(Error::Io(error)) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
            Ok(None)
        }
        Err(error) => Err(error),
    }
}

/// Ends the conversation, and hears the client out: a socket that is closed with something unread in it throws away
/// what it has not sent.
fn part(socket: &mut WebSocket<TcpStream>) -> Result<(), Error> {
    socket.close(None)?;
    socket.flush()?;
    let began = Instant::now();
    while began.elapsed() < FAREWELL {
        listen(socket, ROUND)?;
    }
    Ok(())
}
