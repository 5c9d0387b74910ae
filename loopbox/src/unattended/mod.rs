//! An agent that nobody looks after, on a robot say: sessions one after another, for ever.
//!
//! [`AgentConfig`] is what it is told (`agent.toml`). [`supervise`] opens the camera, or waits for it, and [runs](crate::run())
//! session after session, each in a folder of its own (`sessions`), going on in the newest map that can be read
//! (`resuming`). Beside them `pulse` writes the [`heartbeat`], feeds the service manager's watchdog (`manager`) and watches
//! the memory, and `housekeeping` keeps what is kept within the disk's budget (`room`). All of them share `vitals`. `page` and
//! `pairing` live over all sessions.
//!
//! Nothing here ends a map in another way than a power cut would: whatever a session has settled is on the disk within
//! seconds ([`RunOptions::unattended`](crate::run::RunOptions::unattended)), and the next one reads it from there.

pub mod config;
pub mod heartbeat;
mod housekeeping;
mod manager;
mod page;
mod pairing;
mod pulse;
mod resuming;
mod room;
mod sessions;
mod supervising;
mod vitals;

pub use config::AgentConfig;
pub use heartbeat::{Heartbeat, State};
pub use supervising::{Over, supervise};
pub use vitals::Report;
