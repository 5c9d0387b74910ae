//! One page's WebSocket: commands come in, news of the scene goes out.

use super::encode;
use crate::watch::{Command, Cursor, Shared};
use std::io::ErrorKind;
use std::net::TcpStream;
use std::time::Duration;
use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Error, Message, WebSocket};

/// Commands are short; nothing longer is read.
const MAX_COMMAND: usize = 1024;
/// How often the scene is looked at for news.
const ROUND: Duration = Duration::from_millis(40);
/// The same while points are waiting.
const BUSY_ROUND: Duration = Duration::from_millis(2);
/// Points sent in a round, bytes: so many that the first picture is not kept waiting long.
const POINTS_A_ROUND: usize = 1 << 20;
/// A client that takes nothing for so long is given up.
const WRITE_PATIENCE: Duration = Duration::from_secs(10);

/// Serves a client until it leaves, is too slow, or the run is over and it knows all.
pub fn serve(stream: TcpStream, shared: &Shared) {
    let config = WebSocketConfig::default()
        .max_message_size(Some(MAX_COMMAND))
        .max_frame_size(Some(MAX_COMMAND))
        .read_buffer_size(MAX_COMMAND);
    if stream.set_nodelay(true).is_err() || stream.set_write_timeout(Some(WRITE_PATIENCE)).is_err() {
        return;
    }
    let mut socket = WebSocket::from_raw_socket(stream, Role::Server, Some(config));
    // An error is the client's leaving, by which nothing is lost.
    let _ = talk(&mut socket, shared);
}

fn talk(socket: &mut WebSocket<TcpStream>, shared: &Shared) -> Result<(), Error> {
    let _seat = shared.join();
    let mut cursor = Cursor::default();
    loop {
        let over = shared.is_over();
        let (news, level) = {
            let scene = shared.scene();
            let news = scene.news(&mut cursor, POINTS_A_ROUND);
            let level = (!news.keyframes.is_empty()).then(|| scene.level());
            (news, level)
        };
        for message in encode::messages(&news, level) {
            socket.write(message)?;
        }
        socket.flush()?;
        if over && !news.more {
            socket.close(None)?;
            return socket.flush();
        }
        listen(socket, shared, if news.more { BUSY_ROUND } else { ROUND })?;
    }
}

/// Takes one message if one comes in time.
fn listen(socket: &mut WebSocket<TcpStream>, shared: &Shared, patience: Duration) -> Result<(), Error> {
    socket.get_ref().set_read_timeout(Some(patience))?;
    match socket.read() {
        Ok(Message::Text(text)) => {
            if let Ok(command) = serde_json::from_str::<Command>(&text) {
                shared.command(command);
            }
            Ok(())
        }
        Ok(_) => Ok(()),
        Err(Error::Io(error)) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
            Ok(())
        }
        Err(error) => Err(error),
    }
}
