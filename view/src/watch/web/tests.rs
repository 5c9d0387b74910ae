//! The server, asked over its socket.

use super::*;
use crate::watch::Scene;
use std::io::{Read, Write};

const TOKEN: &str = "open-sesame";

/// A page that only who has the token may see, and its address.
fn guarded() -> (Server, SocketAddr) {
    let shared = Arc::new(Shared::new(Scene::default(), None));
    let address = Address::new(Ipv4Addr::LOCALHOST.into(), Some(0), Some(TOKEN.into())).unwrap();
    let server = Server::of_station(&shared, address, "yard").unwrap();
    let at = server.url()["http://".len()..].split('/').next().unwrap().parse().unwrap();
    (server, at)
}

/// The whole answer to a request for `path` with these headers.
fn ask(at: SocketAddr, path: &str, headers: &str) -> String {
    let mut stream = TcpStream::connect(at).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\nHost: {at}\r\n{headers}\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

/// The value of a header.
fn header<'a>(answer: &'a str, name: &str) -> Option<&'a str> {
    answer.split("\r\n").find_map(|line| line.strip_prefix(name)?.strip_prefix(": "))
}

#[test]
fn the_browser_keeps_the_token_so_that_it_can_leave_the_address() {
    let (_server, at) = guarded();
    let answer = ask(at, &format!("/?token={TOKEN}"), "");
    let cookie = header(&answer, "Set-Cookie").expect("a cookie");
    assert!(cookie.ends_with(&format!("={TOKEN}; Path=/; HttpOnly; SameSite=Strict")), "{cookie}");
    let pair = cookie.split(';').next().unwrap();
    let again = ask(at, "/", &format!("Cookie: theme=dark; {pair}\r\n"));
    assert!(again.starts_with("HTTP/1.1 200 OK"), "{}", &again[..200]);
    assert_eq!(header(&again, "Set-Cookie"), None);
    for foreign in ["", "Cookie: loopbox-1=open-sesame\r\n", &format!("Cookie: {}x\r\n", pair)] {
        assert!(ask(at, "/", foreign).starts_with("HTTP/1.1 403 Forbidden"), "{foreign}");
    }
}

#[test]
fn a_page_is_served_with_its_policy_in_which_nothing_is_unsafe() {
    let (_server, at) = guarded();
    let answer = ask(at, &format!("/?token={TOKEN}"), "");
    let policy = header(&answer, "Content-Security-Policy").expect("a policy");
    for part in ["default-src 'none'", "base-uri 'none'", "form-action 'none'", "frame-ancestors 'none'"] {
        assert!(policy.split("; ").any(|one| one == part), "{part} is not in {policy}");
    }
    assert!(!policy.contains("unsafe") && policy.matches("'sha256-").count() == 2, "{policy}");
}

#[test]
fn strangers_that_never_end_their_requests_keep_nobody_out() {
    let (_server, at) = guarded();
    let half: Vec<TcpStream> = (0..200)
        .map(|_| {
            let mut stream = TcpStream::connect(at).unwrap();
            // One that was shown out already takes no more.
            let _ = stream.write_all(b"GET /");
            stream
        })
        .collect();
    let began = Instant::now();
    let answer = ask(at, &format!("/?token={TOKEN}"), "");
    assert!(answer.starts_with("HTTP/1.1 200 OK"), "{}", &answer[..answer.len().min(200)]);
    assert!(began.elapsed() < READ_PATIENCE, "it did not wait until they were given up");
    drop(half);
}

#[test]
fn a_report_is_served_once_it_is_written() {
    let (server, at) = guarded();
    let ask = || ask(at, &format!("/report.html?token={TOKEN}"), "");
    assert!(ask().starts_with("HTTP/1.1 404 Not Found"));
    let folder = tempfile::tempdir().unwrap();
    let report = folder.path().join("report.html");
    std::fs::write(&report, "<meta content=\"default-src 'none'; img-src data:\">drawn").unwrap();
    server.offer_report(report);
    let answer = ask();
    assert!(answer.ends_with("drawn"), "{answer}");
    let policy = header(&answer, "Content-Security-Policy");
    assert_eq!(policy, Some("default-src 'none'; img-src data:; frame-ancestors 'none'"));
}

#[test]
fn numbers_are_told_to_who_has_the_token_and_to_nobody_else() {
    let (_server, at) = guarded();
    for refused in ["", "Authorization: Bearer open-sesam\r\n", &format!("Authorization: Basic {TOKEN}\r\n")]
    {
        assert!(ask(at, "/metrics", refused).starts_with("HTTP/1.1 403 Forbidden"), "{refused}");
    }
    let bearer = ask(at, "/metrics", &format!("Authorization: Bearer {TOKEN}\r\n"));
    for answer in [bearer, ask(at, &format!("/metrics?token={TOKEN}"), "")] {
        assert!(answer.starts_with("HTTP/1.1 200 OK"), "{answer}");
        assert_eq!(header(&answer, "Content-Type"), Some("text/plain; version=0.0.4; charset=utf-8"));
        assert!(answer.ends_with('\n') && answer.contains("\nloopbox_keyframes 0\n"), "{answer}");
        assert_eq!(header(&answer, "Set-Cookie"), None);
    }
}

#[test]
fn between_the_runs_of_an_agent_its_health_is_told_and_a_page_of_no_scene_has_no_numbers() {
    let own = |port| Address::new(Ipv4Addr::LOCALHOST.into(), Some(port), None).unwrap();
    let at = |server: &Server| server.url()["http://".len()..].split('/').next().unwrap().parse().unwrap();
    let agent = Server::with_health(own(0), Box::new(|| (true, "{}".into()))).unwrap();
    assert!(ask(at(&agent), "/metrics", "").contains("\nloopbox_healthy 1\n"));
    let shared = Arc::new(Shared::new(Scene::default(), None));
    let other =
        Server::serve(own(0), "a page".into(), move || Box::new(run::Audience::join(&shared))).unwrap();
    assert!(ask(at(&other), "/metrics", "").starts_with("HTTP/1.1 404 Not Found"));
}
