//! What carries messages between nodes: links that come and go, on which messages may be lost.

mod queue;
pub mod tcp;
#[cfg(test)]
mod tests;

use crate::node::LinkId;
use crate::wire::Priority;

/// Carries messages. What happens on its links it tells as [`Event`](crate::node::Event)s to whoever started it.
pub trait Transport: Send {
    /// Sends a message on a link; never waits. Without room it is dropped.
    fn send(&self, link: LinkId, priority: Priority, bytes: Vec<u8>);

    /// Closes a link once what was sent on it is on its way, or cannot be.
    fn close(&self, link: LinkId);
}
