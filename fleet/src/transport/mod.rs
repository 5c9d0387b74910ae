//! What carries messages between nodes: links that come and go, on which messages may be lost.

mod backlog;
mod congestion;
mod endpoint;
mod queue;
mod stream;
pub mod tcp;
#[cfg(test)]
mod tests;
mod tls;

pub use endpoint::Endpoint;

use crate::node::LinkId;
use crate::wire::Priority;
use std::io::{Error, ErrorKind};

/// Carries messages. What happens on its links it tells as [`Event`](crate::node::Event)s to whoever started it.
pub trait Transport: Send + Sync {
    /// Sends a message on a link; never waits. Without room it is dropped.
    fn send(&self, link: LinkId, priority: Priority, bytes: Vec<u8>);

    /// A message of so many bytes that came on a link was looked at: as much more may come.
    fn looked_at(&self, link: LinkId, bytes: usize);

    /// Closes a link once what was sent on it is on its way, or cannot be.
    fn close(&self, link: LinkId);
}

/// Whether only time has passed.
fn is_patience(error: &Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted)
}
