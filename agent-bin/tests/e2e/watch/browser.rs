//! The page in a browser: headless Chromium, driven over its DevTools protocol. Skipped, loudly, where there is none.

use super::long_case;
use super::served::Served;
use super::socket::PATIENCE;
use base64::Engine;
use serde_json::{Value, json};
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
    /// Opens a page; `None`, and a note, where there is no Chromium.
    pub fn open(url: &str) -> Option<Self> {
        let profile = tempfile::tempdir().expect("a temporary folder can be made");
        let child = ["chromium", "chromium-browser", "google-chrome"]
            .iter()
            .find_map(|name| start(name, profile.path()).ok());
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
        browser.call("Page.navigate", json!({ "url": url }));
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
                assert!(answer["error"].is_null(), "{method}: {answer}");
                return answer["result"].clone();
            }
        }
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
        let shot = self.call("Page.captureScreenshot", json!({ "format": "png" }));
        let text = shot["data"].as_str().expect("a picture");
        let png = base64::engine::general_purpose::STANDARD.decode(text).expect("base64");
        std::fs::write(path, png).expect("the picture can be written");
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // It may be gone already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn start(name: &str, profile: &Path) -> std::io::Result<Child> {
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
        "--window-size=1200,760",
        "--hide-scrollbars",
    ];
    Command::new(name)
        .args(flags)
        .arg(format!("--user-data-dir={}", profile.display()))
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

#[test]
#[ignore = "depends on how fast the machine draws: cargo test --test e2e -- --ignored the_page_shows"]
fn the_page_shows_a_run_and_its_buttons_work() {
    let case = long_case();
    // Slowly, so that the run does not end before a busy machine has opened the page.
    let mut run = Served::start(case.command(&["--view=0", "--realtime", "--speed", "0.3"]));
    let Some(mut page) = Browser::open(&run.url) else { return };
    page.until("the page", |p| p.value("document.documentElement.dataset.page") == "complete");
    page.until("points drawn", |p| p.number("drawn") > 0.0 && p.number("points") > 1000.0);
    page.until("depth over the image", |p| p.number("overlaid") > 50.0);
    let frame = page.text("number-frame");
    page.until("its numbers to move", |p| p.text("number-frame") != frame);
    assert!(page.text("number-memory").ends_with("MiB"));

    page.click("record");
    page.until("recording", |p| p.text("record") == "Stop recording");
    page.click("record");
    page.until("the end of recording", |p| p.text("record") == "Record");
    page.click("pause");
    page.until("the pause", |p| p.text("pause") == "Resume" && p.text("state") == "paused");
    let frame = page.text("number-frame");
    std::thread::sleep(Duration::from_millis(400));
    assert_eq!(page.text("number-frame"), frame);
    page.click("save");
    page.until("the results", |p| p.text("note").contains("saved to"));
    page.screenshot(&Path::new(env!("CARGO_TARGET_TMPDIR")).join("view.png"));
    page.click("restart");
    page.until("a new map", |p| p.number("points") == 0.0 || p.text("number-keyframes") == "0");
    page.click("pause");
    page.until("frames again", |p| p.text("pause") == "Pause" && p.text("number-frame") != frame);
    run.interrupt();
    page.until("the end", |p| p.text("state") == "finished");
    assert!(page.text("banner").contains("out-2") || page.text("banner").contains("ended"));
    assert!(run.wait().success());
    assert!(page.errors.is_empty(), "{:?}", page.errors);
}
