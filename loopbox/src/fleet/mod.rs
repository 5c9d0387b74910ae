//! Agents that pair over a network, with or without a station: what a run and a station do with the crate `fleet`.
//!
//! `telling` tells a run's map while it grows, `sketching` says what of others' is worth fetching first, `collecting` merges the maps that come and keeps the common map on disk,
//! `findings` is what it tells the agents about where they are; `party` puts them together.

mod collecting;
mod findings;
mod party;
mod sketching;
mod telling;

pub use findings::{Found, FoundAgent, FoundMeeting};
pub use fleet::service::Endpoint;
pub use party::{AgentLine, Fleet, FleetOptions, LinkLine, OBJECTS, STATUS, StatusFile, read_status};
pub use telling::Teller;
