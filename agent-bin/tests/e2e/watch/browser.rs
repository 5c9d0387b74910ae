//! A page in a browser: headless Chromium, driven over its DevTools protocol. Skipped, loudly, where there is none.

use super::socket::PATIENCE;
use base64::Engine;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;
use tungstenite::{Message, WebSocket};

/// A page open in Chromium.
pub struct Browser {
    child: Child,
    socket: WebSocket<TcpStream>,
    session: String,
    last_id: u64,
    /// Errors of the page's scripts.
    pub errors: Vec<String>,
    // Dropped last, when Chromium is gone.
    _profile: TempDir,
}

impl Browser {
    /// Opens a page in a window of this size; `None`, and a note, where there is no Chromium.
    pub fn open(url: &str, window: [u32; 2]) -> Option<Self> {
        let profile = tempfile::tempdir().expect("a temporary folder can be made");
        let child = ["chromium", "chromium-browser", "google-chrome"]
            .iter()
            .find_map(|name| start(name, profile.path(), window).ok());
        let Some(child) = child else {
            eprintln!(
                "SKIPPED: no Chromium here, the page was not opened in a browser (script/setup --browser)"
            );
            return None;
        };
        let (port, path) = devtools(profile.path());
        let stream = TcpStream::connect(("127.0.0.1", port)).expect("DevTools listens");
        let (socket, _) =
            tungstenite::client(format!("ws://127.0.0.1:{port}{path}"), stream).expect("DevTools agrees");
        let session = String::new();
        let mut browser = Self { child, socket, session, last_id: 0, errors: Vec::new(), _profile: profile };
        let target = browser.call("Target.createTarget", json!({ "url": "about:blank" }));
        let attach = json!({ "targetId": target["targetId"], "flatten": true });
        let attached = browser.call("Target.attachToTarget", attach);
        browser.session = attached["sessionId"].as_str().expect("a session").to_owned();
        browser.call("Runtime.enable", json!({}));
        browser.call("Page.enable", json!({}));
        browser.go(url);
        Some(browser)
    }

    /// Calls a method of DevTools.
    pub fn call(&mut self, method: &str, params: Value) -> Value {
        self.last_id += 1;
        let mut message = json!({ "id": self.last_id, "method": method, "params": params });
        if !self.session.is_empty() {
            message["sessionId"] = json!(self.session);
        }
        self.socket.send(Message::text(message.to_string())).expect("DevTools takes it");
        loop {
            let Message::Text(text) = self.socket.read().expect("DevTools answers") else { continue };
            let answer: Value = serde_json::from_str(&text).expect("JSON");
            if answer["method"] == "Runtime.exceptionThrown" {
                self.errors.push(answer["params"]["exceptionDetails"].to_string());
            }
            if answer["id"] == self.last_id {
                // A page that is left for another one has no value yet.
                let is_left = method == "Runtime.evaluate"
                    && answer["error"]["message"] == "Inspected target navigated or closed";
                assert!(is_left || answer["error"].is_null(), "{method}: {answer}");
                return answer["result"].clone();
            }
        }
    }

    /// Goes to another page.
    pub fn go(&mut self, url: &str) {
        self.call("Page.navigate", json!({ "url": url }));
    }

    /// The value of an expression in the page.
    pub fn value(&mut self, expression: &str) -> Value {
        let result =
            self.call("Runtime.evaluate", json!({ "expression": expression, "returnByValue": true }));
        result["result"]["value"].clone()
    }

    /// What an element shows.
    pub fn text(&mut self, id: &str) -> String {
        let value = self.value(&format!("document.getElementById({id:?})?.textContent"));
        value.as_str().unwrap_or_default().to_owned()
    }

    /// A number that the page keeps for tests.
    pub fn number(&mut self, name: &str) -> f64 {
        let value = self.value(&format!("Number(document.documentElement.dataset.{name})"));
        value.as_f64().unwrap_or(f64::NAN)
    }

    /// Clicks an element.
    pub fn click(&mut self, id: &str) {
        self.value(&format!("document.getElementById({id:?}).click()"));
    }

    /// Waits until something holds.
    pub fn until(&mut self, what: &str, mut holds: impl FnMut(&mut Self) -> bool) {
        let began = Instant::now();
        while !holds(self) {
            assert!(began.elapsed() < PATIENCE, "in vain waited for: {what}; errors: {:?}", self.errors);
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    /// Writes a picture of the page.
    pub fn screenshot(&mut self, path: &Path) {
        let png = self.png(json!({ "format": "png" }));
        std::fs::write(path, png).expect("the picture can be written");
    }

    /// How many colours an element shows.
    pub fn colours(&mut self, id: &str) -> usize {
        let mut clip = self.value(&format!(
            "(({{ x, y, width, height }}) => ({{ x, y, width, height }}))(document.getElementById({id:?}).getBoundingClientRect())"
        ));
        clip["scale"] = json!(1);
        let png = self.png(json!({ "format": "png", "clip": clip }));
        let picture = image::load_from_memory(&png).expect("a picture").to_rgb8();
        picture.pixels().map(|pixel| pixel.0).collect::<BTreeSet<_>>().len()
    }

    fn png(&mut self, how: Value) -> Vec<u8> {
        let shot = self.call("Page.captureScreenshot", how);
        let text = shot["data"].as_str().expect("a picture");
        base64::engine::general_purpose::STANDARD.decode(text).expect("base64")
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // It may be gone already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn start(name: &str, profile: &Path, [width, height]: [u32; 2]) -> std::io::Result<Child> {
    let flags = [
        "--headless",
        "--no-sandbox",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
        "--disable-quic",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
        "--remote-debugging-port=0",
        "--hide-scrollbars",
    ];
    Command::new(name)
        .args(flags)
        .arg(format!("--user-data-dir={}", profile.display()))
        .arg(format!("--window-size={width},{height}"))
        .arg("about:blank")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
}

/// Port and path of DevTools, which Chromium writes into its profile.
fn devtools(profile: &Path) -> (u16, String) {
    let began = Instant::now();
    loop {
        if let Ok(text) = std::fs::read_to_string(profile.join("DevToolsActivePort"))
            && let Some((port, path)) = text.trim().split_once('\n')
        {
            return (port.parse().expect("a port"), path.to_owned());
        }
        assert!(began.elapsed() < PATIENCE, "Chromium does not say where its DevTools listen");
        std::thread::sleep(Duration::from_millis(50));
    }
}
