//! Someone who watches a run: the program prints an address, and all that is sent there is taken.

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use tungstenite::http::Uri;
use tungstenite::{ClientRequestBuilder, Message, WebSocket};

/// The protocol of Foxglove's SDK.
const FOXGLOVE_PROTOCOL: &str = "foxglove.sdk.v1";
/// The first byte of the page's messages that hold an image.
const PAGE_PICTURE: u8 = 4;

/// How a run is watched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Viewer {
    /// Through the page.
    Page,
    /// As Foxglove does, all channels subscribed.
    Foxglove,
}

/// What came while watching.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Received {
    /// Messages.
    pub messages: u64,
    /// Bytes of those that are not text: points, poses, images.
    pub bytes: u64,
    /// Messages of the page that held an image.
    pub pictures: u64,
}

/// A running program, which must not outlive its measurement.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Runs a command to its end and watches it from the first moment on.
///
/// # Errors
/// When it cannot be started, prints no address, cannot be connected to, or fails.
pub fn watch(command: &mut Command, viewer: Viewer) -> Result<Received> {
    let started = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn();
    let mut running = Running(started.with_context(|| format!("{command:?} cannot be started"))?);
    let errors = running.0.stderr.take().context("its messages cannot be read")?;
    let mut lines = BufReader::new(errors).lines().map_while(Result::ok);
    let mut output = Vec::new();
    let address = lines.find_map(|line| {
        let found = address(&line).map(str::to_owned);
        output.push(line);
        found
    });
    // Someone must read what it says later.
    let rest = std::thread::spawn(move || lines.collect::<Vec<_>>());
    let received = match address {
        Some(address) => take_all(connect(&address, viewer)?, viewer),
        None => Received::default(),
    };
    if viewer == Viewer::Page {
        // The page stays until somebody ends it; where the program has ended by itself nobody is there to be told.
        let _ =
            Command::new("kill").args(["-INT", &running.0.id().to_string()]).stderr(Stdio::null()).status();
    }
    let status = running.0.wait().context("its end cannot be waited for")?;
    output.extend(rest.join().unwrap_or_default());
    if !status.success() {
        bail!("{command:?} ended with {status}: {}", output.join("\n"));
    }
    // A greeting alone is nothing to see.
    if received.bytes == 0 {
        bail!("{command:?} showed nothing to who watched: {}", output.join("\n"));
    }
    Ok(received)
}

/// The address in a line that the program prints.
fn address(line: &str) -> Option<&str> {
    let begins = ["http://", "ws://"].iter().find_map(|scheme| line.find(scheme))?;
    line[begins..].split_whitespace().next()
}

/// The address of the WebSocket: of a page, beside it, with what its own address asks with (the token).
fn websocket_address(address: &str) -> String {
    let Some(page) = address.strip_prefix("http://") else { return address.to_owned() };
    let (host, rest) = page.split_once('/').unwrap_or((page, ""));
    let query = rest.split_once('?').map_or(String::new(), |(_, query)| format!("?{query}"));
    format!("ws://{host}/ws{query}")
}

fn connect(address: &str, viewer: Viewer) -> Result<WebSocket<TcpStream>> {
    let address = websocket_address(address);
    let uri: Uri = address.parse().with_context(|| format!("{address} is no address"))?;
    let host = uri.authority().with_context(|| format!("{address} names no host"))?.as_str();
    let stream = TcpStream::connect(host).with_context(|| format!("{host} does not listen"))?;
    let mut request = ClientRequestBuilder::new(uri.clone());
    if viewer == Viewer::Foxglove {
        request = request.with_sub_protocol(FOXGLOVE_PROTOCOL);
    }
    let (socket, _) = tungstenite::client(request, stream)
        .map_err(|error| anyhow::anyhow!("{address} does not speak WebSocket: {error}"))?;
    Ok(socket)
}

/// Takes what comes until the program ends the connection, or says on its page that the run is over.
fn take_all(mut socket: WebSocket<TcpStream>, viewer: Viewer) -> Received {
    let mut received = Received::default();
    let mut subscribed = 0;
    // An error is the end of the program, which its exit status tells more of.
    while let Ok(message) = socket.read() {
        received.messages += 1;
        if let Message::Binary(bytes) = &message {
            received.bytes += bytes.len() as u64;
        }
        match &message {
            Message::Binary(bytes) if viewer == Viewer::Page => {
                received.pictures += u64::from(bytes.first() == Some(&PAGE_PICTURE));
            }
            Message::Text(text) if viewer == Viewer::Page && is_end(text) => break,
            Message::Text(text) => {
                let answer = match viewer {
                    Viewer::Page => taken_in(text),
                    Viewer::Foxglove => subscription(text, &mut subscribed),
                };
                if answer.is_some_and(|answer| socket.send(Message::text(answer)).is_err()) {
                    break;
                }
            }
            _ => {}
        }
    }
    received
}

/// The answer to the mark that ends a round of the page's messages: that it was taken in.
fn taken_in(mark: &str) -> Option<String> {
    let mark: Value = serde_json::from_str(mark).ok()?;
    (mark["kind"] == "round").then(|| json!({ "answer": mark["round"] }).to_string())
}

/// Whether a message says that the run is over.
fn is_end(text: &str) -> bool {
    let message: Option<Value> = serde_json::from_str(text).ok();
    message.is_some_and(|message| message["status"]["state"] == "done")
}

/// The answer to an advertisement of channels: all of them.
fn subscription(advertisement: &str, subscribed: &mut u32) -> Option<String> {
    let advertisement: Value = serde_json::from_str(advertisement).ok()?;
    if advertisement["op"] != "advertise" {
        return None;
    }
    let subscribe = |channel: &Value| {
        *subscribed += 1;
        json!({ "id": *subscribed, "channelId": channel["id"] })
    };
    let wanted: Vec<Value> = advertisement["channels"].as_array()?.iter().map(subscribe).collect();
    Some(json!({ "op": "subscribe", "subscriptions": wanted }).to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_found_in_what_is_printed() {
        assert_eq!(
            address("watch at http://127.0.0.1:7171/?token=a b"),
            Some("http://127.0.0.1:7171/?token=a")
        );
        assert_eq!(address("warning: none"), None);
        assert_eq!(websocket_address("http://127.0.0.1:7171/?token=a"), "ws://127.0.0.1:7171/ws?token=a");
        assert_eq!(websocket_address("http://127.0.0.1:7171/"), "ws://127.0.0.1:7171/ws");
        assert_eq!(websocket_address("ws://127.0.0.1:8765"), "ws://127.0.0.1:8765");
    }

    #[test]
    fn every_round_is_answered() {
        assert_eq!(taken_in(r#"{"kind":"round","round":7}"#).as_deref(), Some(r#"{"answer":7}"#));
        assert_eq!(taken_in(r#"{"kind":"status","status":{}}"#), None);
    }

    #[test]
    fn the_end_of_the_run_is_recognised() {
        assert!(is_end(r#"{"kind":"status","status":{"state":"done","frame":9}}"#));
        assert!(!is_end(r#"{"kind":"status","status":{"state":"tracking"}}"#) && !is_end("done"));
    }

    #[test]
    fn every_channel_is_subscribed_once() {
        let mut subscribed = 0;
        let first = subscription(r#"{"op":"advertise","channels":[{"id":7},{"id":9}]}"#, &mut subscribed);
        let wanted: Value = serde_json::from_str(&first.unwrap()).unwrap();
        assert_eq!(wanted["subscriptions"], json!([{"id":1,"channelId":7},{"id":2,"channelId":9}]));
        let next = subscription(r#"{"op":"advertise","channels":[{"id":11}]}"#, &mut subscribed);
        assert!(next.unwrap().contains(r#""id":3"#));
        assert_eq!(subscription(r#"{"op":"serverInfo"}"#, &mut subscribed), None);
    }

    #[test]
    fn a_program_that_ends_without_an_address_is_reported() {
        let output = watch(Command::new("sh").args(["-c", "echo no page >&2; exit 3"]), Viewer::Page);
        let output = output.unwrap_err().to_string();
        assert!(output.contains("exit status: 3") && output.contains("no page"), "{output}");
    }
}
