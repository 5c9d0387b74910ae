//! Watching runs and maps: the page's server, the WebSocket, commands, and the page in a browser.

mod browser;
#[cfg(feature = "foxglove-server")]
mod foxglove;
mod in_browser;
mod many;
#[cfg(feature = "fleet")]
mod near;
mod page;
mod served;
mod socket;

use crate::support::{Case, hand_held};

/// A recording so long that it cannot end while the test looks away.
fn long_case() -> Case {
    Case::new(&hand_held(500))
}
