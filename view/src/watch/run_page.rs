//! The page of a run, from before its first frame until the user has seen enough: what is done before there is a run, as to find
//! the lens, is told on it, and when the run is over it can still be looked at.

use super::scene::{Agent, Scene};
use super::status::Status;
use super::web::{Address, Server};
use super::{Command, Picture, Shared};
use anyhow::Result;
use slam_direct::Frame;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Commands that may wait.
pub(super) const COMMANDS: usize = 16;
/// Images shown before the run, as of a run.
const PICTURE_INTERVAL: Duration = Duration::from_millis(100);

/// A page being served. Clones are one.
#[derive(Clone)]
pub struct RunPage(Arc<Inner>);

struct Inner {
    shared: Arc<Shared>,
    server: Server,
    /// What the user wants, until a run takes it.
    commands: Mutex<Option<Receiver<Command>>>,
    /// When the newest image was taken over.
    pictured: Mutex<Option<Instant>>,
}

impl RunPage {
    /// Begins to serve it, for a run over so many frames.
    ///
    /// # Errors
    /// When the address cannot be listened at.
    pub fn start(address: Address, title: &str, frames: Option<u64>) -> Result<Self> {
        let (sender, commands) = sync_channel(COMMANDS);
        let shared = Arc::new(Shared::new(Scene::default(), Some(sender)));
        shared.scene().set_status(Status { state: "preparing", frames, ..Status::default() });
        let server = Server::start(&shared, address, title)?;
        Ok(Self(Arc::new(Inner {
            shared,
            server,
            commands: Mutex::new(Some(commands)),
            pictured: Mutex::default(),
        })))
    }

    /// Where to open it.
    pub fn url(&self) -> &str {
        self.0.server.url()
    }

    /// Says what is done, before there is a run.
    pub fn tell(&self, text: &str) {
        self.set(|status| text.clone_into(&mut status.note));
    }

    /// Shows a frame that is looked at, before there is a run.
    pub fn show(&self, frame: &Frame) {
        let mut pictured = self.0.pictured.lock().unwrap_or_else(PoisonError::into_inner);
        if pictured.is_some_and(|at| at.elapsed() < PICTURE_INTERVAL) {
            return;
        }
        *pictured = Some(Instant::now());
        self.set(|status| status.frame = frame.index);
        if self.0.shared.audience.load(Ordering::Relaxed) > 0 {
            let picture = Picture::new(frame.index, frame.timestamp, &frame.image);
            self.0.shared.scene().set_picture(picture);
        }
    }

    /// Hands scene and commands to a run of these agents.
    pub(super) fn begin(
        &self,
        agents: Vec<Agent>,
        first: Status,
    ) -> (Arc<Shared>, Option<Receiver<Command>>) {
        let mut scene = self.0.shared.scene();
        scene.set_agents(agents);
        scene.set_status(first);
        drop(scene);
        let commands = self.0.commands.lock().unwrap_or_else(PoisonError::into_inner).take();
        (Arc::clone(&self.0.shared), commands)
    }

    /// The run is over, and this is its report.
    pub(super) fn offer_report(&self, report: &Path) {
        self.0.server.offer_report(report.to_owned());
    }

    /// Lets viewers have the last of it; `failure` is why there are no results.
    pub fn end(&self, failure: Option<&str>) {
        self.set(|status| {
            status.state = "done";
            if let Some(failure) = failure {
                failure.clone_into(&mut status.note);
            }
        });
        self.0.shared.over.store(true, Ordering::Release);
        self.0.server.wait_for_clients();
    }

    fn set(&self, change: impl FnOnce(&mut Status)) {
        self.0.shared.change_status(change);
    }
}

#[cfg(test)]
mod tests {
    use super::super::scene::Cursor;
    use super::*;
    use geometry::GrayImage;
    use std::net::Ipv4Addr;

    #[test]
    fn the_same_page_displays_what_is_done_before_a_run_and_the_run() {
        let address = Address::new(Ipv4Addr::LOCALHOST.into(), Some(0), None).unwrap();
        let page = RunPage::start(address, "yard", Some(90)).unwrap();
        page.tell("finding the lens, round 2");
        let image = GrayImage::filled(64, 48, 90);
        page.show(&Frame { index: 7, timestamp: 0.2, image, color: None });
        let mut cursor = Cursor::default();
        let before = page.0.shared.scene().update_since(&mut cursor, 0);
        let status = before.status.unwrap();
        assert_eq!((status.state, &*status.note), ("preparing", "finding the lens, round 2"));
        assert_eq!((status.frame, status.frames), (7, Some(90)));
        assert!(page.0.shared.command(Command::Pause), "it waits for the run");

        let camera = super::super::chunk::tests::CAMERA;
        let agent = Agent { name: "yard".into(), camera, metric: false };
        let (shared, commands) = page.begin(vec![agent], Status { state: "starting", ..Status::default() });
        assert_eq!(commands.unwrap().try_recv(), Ok(Command::Pause));
        let after = shared.scene().update_since(&mut cursor, 0);
        assert_eq!(after.reset.map(|agents| agents[0].name.clone()).as_deref(), Some("yard"));
        assert!(!shared.is_over());
        page.end(Some("no frame could be tracked"));
        let last = shared.scene().update_since(&mut cursor, 0).status.unwrap();
        assert_eq!((last.state, &*last.note), ("done", "no frame could be tracked"));
        assert!(shared.is_over());
    }
}
