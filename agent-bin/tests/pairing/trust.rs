//! Who is believed: keys made by the program, and peers that are not what they say.

use super::common::{arg, loopbox, stderr, stdout};
use super::{Process, address, assert_is_the_merge_of_the_files, run, status};
use fleet::hash::ObjectHash;
use fleet::keys::{Authority, Keys, Validity};
use fleet::manifest::Manifest;
use fleet::node::Event;
use fleet::transport::tcp::Tcp;
use fleet::transport::{Endpoint, Transport};
use fleet::wire::{MapVersion, Message, Role, VERSIONS};
use loopbox::fleet::StatusFile;
use map::{Identity, Uuid};
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, ServerName};
use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant, SystemTime};
use tempfile::TempDir;

const DAY: Duration = Duration::from_secs(86_400);

/// A fleet with its authority.
struct Yard(TempDir);

impl Yard {
    fn new() -> Self {
        let yard = Self(tempfile::tempdir().expect("a folder"));
        let made = loopbox(&["keys", "init", arg(&yard.at("authority"))]);
        assert!(made.status.success(), "{}", stderr(&made));
        yard
    }

    fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// The folder with the keys of a party, made by the program.
    fn keys(&self, name: &str) -> PathBuf {
        let (authority, out) = (self.at("authority"), self.at(&format!("keys-{name}")));
        let made = loopbox(&["keys", "agent", name, "--authority", arg(&authority), "--out", arg(&out)]);
        assert!(made.status.success(), "{}", stderr(&made));
        assert!(stdout(&made).contains(&format!("--keys {}", out.display())), "{}", stdout(&made));
        out
    }

    /// A station, and where it listens.
    fn station(&self, more: &[&str]) -> (Process, PathBuf, Endpoint) {
        let (out, keys) = (self.at("station"), self.keys("station"));
        let listen = ["--listen", "tls/127.0.0.1:0", "--keys", arg(&keys)];
        let process =
            Process::start(&[&["station", "--quiet", "--out", arg(&out)], &listen[..], more].concat());
        let at = address(&out);
        assert!(at.starts_with("tls/"), "{at}");
        (process, out, at.parse().expect("an address"))
    }
}

/// Waits until a station says it in its file.
fn says(station: &Path, words: &str) {
    let is_reported = |text: &serde_json::Value| text.as_str().is_some_and(|text| text.contains(words));
    status(station, |status| {
        status["trouble"].as_array().is_some_and(|trouble| trouble.iter().any(is_reported))
    });
}

/// One that speaks the protocol, and says what it wants.
struct Peer {
    keys: Keys,
    tcp: Tcp,
    happened: Receiver<Event>,
    link: u64,
}

impl Peer {
    fn dials(at: &Endpoint, keys: &Path) -> Self {
        let keys = Keys::open(keys).expect("keys");
        let (events, happened) = channel();
        let tcp = Tcp::start(None, std::slice::from_ref(at), Some(&keys), events).expect("it dials");
        let mut peer = Self { keys, tcp, happened, link: 0 };
        peer.link = peer.wait(|event| if let Event::Up { link, .. } = event { Some(*link) } else { None });
        peer
    }

    /// Waits for something to happen.
    fn wait<T>(&self, mut wanted: impl FnMut(&Event) -> Option<T>) -> T {
        let end = Instant::now() + Duration::from_secs(60);
        while Instant::now() < end {
            let event = self.happened.recv_timeout(Duration::from_secs(60)).expect("something happens");
            if let Some(found) = wanted(&event) {
                return found;
            }
        }
        panic!("it does not happen");
    }

    fn says(&self, message: &Message) {
        self.tcp.send(self.link, message.priority(), message.to_bytes());
    }

    fn greets(&self) {
        let peer = self.keys.peer();
        let (node, name) = (peer.id, peer.name.clone());
        self.says(&Message::Hello { version: VERSIONS[0], node, role: Role::Agent, name, results: None });
    }

    fn tells(&self, version: MapVersion) {
        self.says(&Message::State { version, signature: Some(self.keys.signer().sign(&version)) });
    }

    /// Hears why it is refused, be it within TLS or by a message.
    fn hears(&self, words: &str) {
        self.wait(|event| {
            let text = match event {
                Event::Trouble(text) => text.clone(),
                Event::Received { bytes, .. } => match Message::from_bytes(bytes) {
                    Ok(Message::Refused { reason }) => reason,
                    _ => return None,
                },
                _ => return None,
            };
            text.contains(words).then_some(())
        });
    }
}

fn manifest(agent: Identity) -> (MapVersion, Vec<u8>) {
    let list = Manifest { agent, begun: 5, revision: 1, finished: false, pages: Vec::new() };
    let bytes = list.to_bytes();
    let (size, hash) = (bytes.len() as u32, ObjectHash::of(&bytes));
    (MapVersion { agent, begun: 5, revision: 1, newest: 0, size, hash }, bytes)
}

fn agent(number: u128) -> Identity {
    Identity { uuid: Uuid::from_u128(number), epoch: 0 }
}

#[test]
fn keys_are_made_by_one_command_a_machine_and_never_replaced() {
    let yard = Yard::new();
    let keys = yard.keys("car-7");
    for private in [yard.at("authority").join("authority.key"), keys.join("agent.key")] {
        let mode = fs::metadata(&private).expect("it is there").permissions().mode();
        assert_eq!(mode & 0o777, 0o600, "{}", private.display());
    }
    let (authority, before) = (yard.at("authority"), fs::read(keys.join("agent.key")).expect("a key"));
    let again = ["keys", "agent", "car-7", "--authority", arg(&authority), "--out", arg(&keys)];
    let (nameless, more) = (yard.at("x"), ["--days", "0"]);
    let cases: [(&[&str], &str); 4] = [
        (&again, "never replaced"),
        (&["keys", "init", arg(&authority)], "never replaced"),
        (&["keys", "agent", "a/b", "--authority", arg(&authority), "--out", arg(&nameless)], "be called so"),
        (&[&again[..6], &[arg(&nameless)], &more].concat(), "1 to"),
    ];
    for (args, words) in cases {
        let output = loopbox(args);
        let printed = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{printed}");
        assert!(printed.contains(words) && printed.contains("hint"), "{printed}");
    }
    assert_eq!(fs::read(keys.join("agent.key")).expect("a key"), before);
    assert!(!nameless.exists());
}

#[test]
fn by_tls_two_agents_and_a_station_merge_as_by_tcp() {
    let yard = Yard::new();
    let (station, out, at) = yard.station(&["--agents", "2"]);
    // By its name, which need not be in its certificate.
    let at = Endpoint { host: "localhost".into(), ..at }.to_string();
    let agents = ["a", "b"].map(|name| {
        let (out, keys) = (yard.at(name), yard.keys(name));
        let process = run(name, &out, &["--connect", &at, "--keys", arg(&keys)]);
        (process, out)
    });
    let [a, b] = agents.map(|(process, out)| {
        assert!(process.succeeded());
        out
    });
    assert!(station.succeeded());
    assert_is_the_merge_of_the_files(&out, [&a, &b], ["a", "b"]);
    let printed = status(&out, |_| true);
    assert!(printed["trouble"].as_array().is_some_and(Vec::is_empty), "{printed:#}");
}

#[test]
fn who_is_not_of_the_fleet_is_refused_and_both_know_why() {
    let (yard, foreign) = (Yard::new(), Yard::new());
    let (_station, out, at) = yard.station(&[]);
    let place = format!("tls/{}", at.host);

    // An agent of another fleet, by the program. What it told is kept in a folder like that of a run.
    let kept = yard.at("kept");
    fs::create_dir(&kept).expect("a folder");
    fs::write(kept.join("fleet.json"), serde_json::to_vec(&StatusFile::default()).expect("numbers"))
        .expect("there is room");
    let theirs = foreign.keys("car");
    let dial = ["fleet", arg(&kept), "--connect", &at.to_string()].map(str::to_owned);
    let dial: Vec<&str> = dial.iter().map(String::as_str).collect();
    let output = loopbox(&[&dial[..], &["--keys", arg(&theirs)]].concat());
    let printed = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{printed}");
    assert!(
        printed.contains(&format!("{at} is refused: its certificate is of another authority")),
        "{printed}"
    );
    says(&out, &format!("{place} refused us: its authority is not the one of our certificate"));

    // One whose time is over: the program says it at once, and a peer that tries nevertheless is refused.
    let expired = yard.at("expired");
    let now = SystemTime::now();
    let over = Validity { from: now - 2 * DAY, until: now - DAY };
    let authority = Authority::open(&yard.at("authority")).expect("an authority");
    authority.issue("late", over, &expired).expect("there is room");
    let output = loopbox(&[&dial[..], &["--keys", arg(&expired)]].concat());
    assert!(
        stderr(&output).contains("certificate of late cannot be used: it has expired"),
        "{}",
        stderr(&output)
    );
    Peer::dials(&at, &expired).hears("by its clock our certificate has expired");
    says(&out, &format!("{place} is refused: its certificate has expired"));

    // One without any certificate, and one that speaks no TLS.
    let reported = strangers_alert(&at, &yard.at("authority").join("authority.crt"));
    assert!(reported.contains("CertificateRequired"), "{reported}");
    says(&out, &format!("{place} is refused: it shows no certificate"));
    let plain = at.to_string().replace("tls/", "tcp/");
    let output = loopbox(&["fleet", arg(&kept), "--connect", &plain]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("speaks TLS: dial tls/"), "{}", stderr(&output));
    says(&out, &format!("{place} is refused: it speaks no TLS"));

    // The fleet goes on.
    let output = loopbox(&[&dial[..], &["--keys", arg(&yard.keys("car"))]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
}

/// What the station answers to one that shows no certificate.
fn strangers_alert(at: &Endpoint, authority: &Path) -> String {
    let mut roots = rustls::RootCertStore::empty();
    roots.add(CertificateDer::from_pem_file(authority).expect("a certificate")).expect("an authority");
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = rustls::ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .expect("versions")
        .with_root_certificates(roots)
        .with_no_client_auth();
    let name = ServerName::try_from("fleet.loopbox").expect("a name");
    let mut session = rustls::ClientConnection::new(Arc::new(config), name).expect("a session");
    let mut socket = TcpStream::connect((&at.host[..], at.port)).expect("it listens");
    let mut stream = rustls::Stream::new(&mut session, &mut socket);
    let answered = stream.write_all(b"hello").and_then(|()| stream.read(&mut [0; 9]));
    answered.expect_err("it is refused").to_string()
}

#[test]
fn a_peer_that_publishes_what_it_does_not_own_or_did_not_sign_is_refused_and_knows_why() {
    let yard = Yard::new();
    let (_station, out, at) = yard.station(&[]);
    let [car, mallory] = ["car", "mallory"].map(|name| yard.keys(name));
    let car = Peer::dials(&at, &car);
    car.greets();
    let (hers, bytes) = manifest(agent(7));
    car.tells(hers);
    // It is asked for the list: so it was believed so far.
    let get = |event: &Event| match event {
        Event::Received { bytes, .. } => match Message::from_bytes(bytes) {
            Ok(Message::Get { hash, .. }) => Some(hash),
            _ => None,
        },
        _ => None,
    };
    assert_eq!(car.wait(get), hers.hash);

    let (own, _) = manifest(agent(9));
    let foreign = MapVersion { begun: 1 << 50, ..hers };
    let signed = |keys: &Keys, version: &MapVersion| Some(keys.signer().sign(version));
    type Forged<'a> = &'a dyn Fn(&Keys) -> Vec<Message>;
    let cases: [(&str, Forged); 4] = [
        ("not mallory's to tell: that agent is car's", &|keys| {
            vec![Message::State { version: foreign, signature: signed(keys, &foreign) }]
        }),
        ("is not signed", &|_| vec![Message::State { version: own, signature: None }]),
        ("is not that of mallory", &|keys| {
            let version = MapVersion { hash: ObjectHash::of(b"another list"), ..own };
            vec![Message::State { version, signature: signed(keys, &own) }]
        }),
        ("an older version", &|keys| {
            let older = MapVersion { begun: 4, ..own };
            [own, older].map(|version| Message::State { version, signature: signed(keys, &version) }).to_vec()
        }),
    ];
    for (words, printed) in cases {
        let peer = Peer::dials(&at, &mallory);
        peer.greets();
        printed(&peer.keys).iter().for_each(|message| peer.says(message));
        peer.hears(words);
        says(&out, words);
    }
    // The list itself is another one than was signed: it is not taken, and may be the fault of a disk.
    let mut tampered = bytes;
    tampered[30] ^= 1;
    car.says(&Message::Part { hash: hers.hash, offset: 0, bytes: tampered });
    says(&out, "car sent an object that is not what it is called");
}
