//! Pages: what is embedded in them, whether they point nowhere, and how they look to a browser.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// The page as Chromium leaves it after its scripts ran; `None` where there is no Chromium.
///
/// # Panics
/// When the page cannot be written or the browser does not end.
pub fn opened(html: &str) -> Option<String> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("report.html");
    std::fs::write(&file, html).unwrap();
    let names = ["chromium", "chromium-browser", "google-chrome"];
    let mut browser = names.iter().find_map(|name| {
        Command::new(name)
            .args(["--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"])
            .args([
                "--no-first-run",
                "--disable-background-networking",
                "--virtual-time-budget=3000",
                "--dump-dom",
            ])
            .arg(format!("--user-data-dir={}", folder.path().join("profile").display()))
            .arg(&file)
            .stdout(std::fs::File::create(folder.path().join("dom.html")).unwrap())
            .stderr(Stdio::null())
            .spawn()
            .ok()
    })?;
    let deadline = Instant::now() + Duration::from_secs(120);
    while browser.try_wait().unwrap().is_none() {
        if Instant::now() > deadline {
            browser.kill().unwrap();
            browser.wait().unwrap();
            panic!("the browser did not finish");
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    Some(std::fs::read_to_string(folder.path().join("dom.html")).unwrap())
}

/// The embedded data of a page, as a browser would read it.
pub fn embedded(page: &str) -> serde_json::Value {
    let (_, rest) = page.split_once(r#"<script type="application/json" id="data">"#).unwrap();
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}

/// Fails where a page would load anything from outside, or run what it did not bring along.
pub fn assert_points_nowhere(page: &str) {
    let page = page.to_lowercase();
    for mark in [
        "http:",
        "https:",
        "src=",
        "href=",
        "@import",
        "url(",
        "fetch(",
        "import(",
        "xmlhttp",
        "websocket",
        "\"//",
    ] {
        assert!(!page.contains(mark), "the page contains {mark}");
    }
    assert!(page.contains("default-src 'none'"));
}
