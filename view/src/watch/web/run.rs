//! A run or a saved map as it is told to a page.

use super::Message;
use super::client::PageSession;
use super::encode;
use crate::watch::{Command, Cursor, Seat, Shared};
use std::sync::Arc;

/// Points sent in a round, bytes: so many that the first picture is not kept waiting long.
const POINTS_A_ROUND: usize = 1 << 20;

/// One page that looks at a scene.
pub struct Audience {
    shared: Arc<Shared>,
    cursor: Cursor,
    _seat: Seat,
}

impl Audience {
    /// Counts it among those that show images, as long as it lives.
    pub fn join(shared: &Arc<Shared>) -> Self {
        Self { shared: Arc::clone(shared), cursor: Cursor::default(), _seat: shared.join() }
    }
}

impl PageSession for Audience {
    fn is_over(&self) -> bool {
        self.shared.is_over()
    }

    fn next_messages(&mut self) -> (Vec<Message>, bool) {
        let (update, level) = {
            let scene = self.shared.scene();
            let update = scene.update_since(&mut self.cursor, POINTS_A_ROUND);
            let level = (!update.keyframes.is_empty()).then(|| scene.level());
            (update, level)
        };
        (encode::messages(&update, level), update.more)
    }

    fn receive(&mut self, text: &str) {
        if let Ok(command) = serde_json::from_str::<Command>(text) {
            self.shared.command(command);
        }
    }
}
