//! A bucket of an S3 server from PyPI (moto) on this machine. `script/buckets` installs it; `LOOPBOX_MOTO` names its program.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// That a request is signed, which the server asks for, and by whom, which it does not check.
const SIGNED: &str =
    "AWS4-HMAC-SHA256 Credential=anybody/20260101/us-east-1/s3/aws4_request, SignedHeaders=host, Signature=0";

/// An S3 server with a bucket, which ends with the test.
pub struct Server {
    process: Child,
    port: u16,
}

impl Server {
    /// Nothing where there is no server's program.
    pub fn begin() -> Option<Self> {
        let program = std::env::var_os("LOOPBOX_MOTO").unwrap_or_else(|| "moto_server".into());
        let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let mut command = Command::new(program);
        command.args(["-H", "127.0.0.1", "-p", &port.to_string()]);
        let Ok(process) = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn() else {
            eprintln!(
                "SKIPPED: no moto_server here, nothing was kept in a bucket (script/buckets installs it)"
            );
            return None;
        };
        let server = Self { process, port };
        let begun = Instant::now();
        while TcpStream::connect(("127.0.0.1", port)).is_err() {
            assert!(begun.elapsed() < Duration::from_secs(60), "the server does not answer");
            std::thread::sleep(Duration::from_millis(100));
        }
        server.ask("PUT", "/bucket", b"");
        Some(server)
    }

    /// What the server answers, without the head of it.
    fn ask(&self, method: &str, path: &str, body: &[u8]) -> Vec<u8> {
        let mut link = TcpStream::connect(("127.0.0.1", self.port)).unwrap();
        let head = format!(
            "{method} {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: {SIGNED}\r\nConnection: close\r\nContent-Length: \
             {}\r\n\r\n",
            body.len()
        );
        link.write_all(head.as_bytes()).unwrap();
        link.write_all(body).unwrap();
        let mut answer = Vec::new();
        link.read_to_end(&mut answer).unwrap();
        let end = answer.windows(4).position(|four| four == b"\r\n\r\n").unwrap();
        let (head, body) = answer.split_at(end + 4);
        let head = String::from_utf8_lossy(head);
        assert!(head.starts_with("HTTP/1.1 200"), "{method} {path}: {head}{}", String::from_utf8_lossy(body));
        body.to_vec()
    }

    /// Puts an object.
    pub fn put(&self, name: &str, bytes: &[u8]) {
        self.ask("PUT", &format!("/bucket/{name}"), bytes);
    }

    /// What is in an object.
    pub fn get(&self, name: &str) -> Vec<u8> {
        self.ask("GET", &format!("/bucket/{name}"), b"")
    }

    /// The names of the objects under a prefix.
    pub fn names(&self, prefix: &str) -> Vec<String> {
        let list = self.ask("GET", &format!("/bucket?list-type=2&prefix={prefix}"), b"");
        let list = String::from_utf8(list).unwrap();
        list.split("<Key>").skip(1).map(|rest| rest.split("</Key>").next().unwrap().to_owned()).collect()
    }

    /// Has a command find the server, and keep what it copies in `cache`.
    pub fn serve<'a>(&self, command: &'a mut Command, cache: &Path) -> &'a mut Command {
        command.env("XDG_CACHE_HOME", cache);
        for (name, value) in [
            ("AWS_ENDPOINT_URL", &*format!("http://127.0.0.1:{}", self.port)),
            ("AWS_ALLOW_HTTP", "true"),
            ("AWS_ACCESS_KEY_ID", "anybody"),
            ("AWS_SECRET_ACCESS_KEY", "anything"),
            ("AWS_REGION", "us-east-1"),
        ] {
            command.env(name, value);
        }
        command
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // Nothing to be done where it ended by itself.
        let _ = self.process.kill().and_then(|()| self.process.wait());
    }
}
