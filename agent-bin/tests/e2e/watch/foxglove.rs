//! What Foxglove is served, asked as Foxglove asks.

use super::long_case;
use super::served::Served;
use super::socket::{PATIENCE, UPGRADE, request};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::net::TcpStream;
use std::time::Instant;
use tungstenite::Message;
use tungstenite::client::IntoClientRequest;
use tungstenite::http::HeaderValue;

/// A page of any site may open a WebSocket to this machine: it must not get to see the run.
#[test]
fn pages_of_others_are_refused() {
    let case = long_case();
    let run = Served::start(case.command(&["--foxglove=0"]));
    let host = run.url.trim_start_matches("ws://");
    let asked = |host_named: &str, origin: Option<&str>| {
        let protocol = ("Sec-WebSocket-Protocol", "foxglove.sdk.v1");
        let mut headers = [&[("Host", host_named)], &UPGRADE[..], &[protocol]].concat();
        headers.extend(origin.map(|origin| ("Origin", origin)));
        request(host, "/", &headers).0
    };
    for (named, origin) in [(host, None), (host, Some("https://app.foxglove.dev"))] {
        assert_eq!(asked(named, origin), "HTTP/1.1 101 Switching Protocols", "{named} {origin:?}");
    }
    for (named, origin) in
        [(host, Some("https://evil.example")), (host, Some("null")), ("evil.example:8765", None)]
    {
        assert_eq!(asked(named, origin), "HTTP/1.1 403 Forbidden", "{named} {origin:?}");
    }
}

#[test]
fn foxglove_gets_image_poses_cloud_and_trajectory() {
    let case = long_case();
    let run = Served::start(case.command(&["--foxglove=0"]));
    let stream = TcpStream::connect(run.url.trim_start_matches("ws://")).expect("it listens");
    let mut request = run.url.as_str().into_client_request().expect("an address");
    request.headers_mut().insert("Sec-WebSocket-Protocol", HeaderValue::from_static("foxglove.sdk.v1"));
    let (mut socket, _) = tungstenite::client(request, stream).expect("it agrees");
    let (mut topics, mut seen) = (BTreeMap::new(), BTreeSet::new());
    let began = Instant::now();
    while seen.len() < 5 {
        assert!(began.elapsed() < PATIENCE, "only {seen:?} of {topics:?}");
        match socket.read().expect("it goes on") {
            Message::Text(text) => {
                let message: Value = serde_json::from_str(&text).expect("JSON");
                for channel in message["channels"].as_array().into_iter().flatten() {
                    let id = channel["id"].as_u64().expect("a number");
                    topics.insert(id as u32, channel["topic"].as_str().expect("a topic").to_owned());
                    let wanted =
                        json!({ "op": "subscribe", "subscriptions": [{ "id": id, "channelId": id }] });
                    socket.send(Message::text(wanted.to_string())).expect("it is taken");
                }
            }
            // A byte for the kind, the subscription, the time, the message.
            Message::Binary(data) if data[0] == 1 => {
                let subscription = u32::from_le_bytes(data[1..5].try_into().expect("four bytes"));
                seen.insert(topics[&subscription].clone());
            }
            _ => {}
        }
    }
    let expected = ["/camera/calibration", "/camera/image", "/keyframes/cloud", "/tf", "/trajectory"];
    assert_eq!(seen.into_iter().collect::<Vec<_>>(), expected);
}
