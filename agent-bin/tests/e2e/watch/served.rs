//! A program that serves a page, as a test holds it.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, ExitStatus, Stdio};

/// A program that printed where it serves its page. It is killed when the test lets go of it.
pub struct Served {
    child: Child,
    /// Where to look.
    pub url: String,
}

impl Served {
    /// Starts it, and waits for the address.
    pub fn start(mut command: Command) -> Self {
        let mut child =
            command.stderr(Stdio::piped()).stdout(Stdio::null()).spawn().expect("loopbox can be started");
        let mut lines = BufReader::new(child.stderr.take().expect("piped")).lines().map_while(Result::ok);
        let url = lines.find_map(|line| line.find("http://").map(|at| line[at..].to_owned()));
        let url =
            url.expect("it prints an address").split_whitespace().next().expect("an address").to_owned();
        // Someone must read what it says.
        std::thread::spawn(move || lines.for_each(drop));
        Self { child, url }
    }

    /// Whether it still runs.
    pub fn runs(&mut self) -> bool {
        self.child.try_wait().expect("a child can be asked").is_none()
    }

    /// Asks it to end.
    pub fn interrupt(&self) {
        let sent = Command::new("kill").args(["-INT", &self.child.id().to_string()]).status();
        assert!(sent.expect("kill can be run").success());
    }

    /// Waits for its end.
    pub fn wait(&mut self) -> ExitStatus {
        self.child.wait().expect("a child can be waited for")
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
