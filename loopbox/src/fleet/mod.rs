//! Agents that pair over a network, with or without a station: what a run and a station do with the crate `fleet`.
//!
//! `telling` tells a run's map while it grows. `sketching` says what of others' is worth fetching first and when enough of
//! it is here, `courtesy` which of two agents looks at it, `company` who hangs together, `collecting`
//! merges the maps that come, in goes, and keeps the common map on disk (`scans` those of LiDARs; `agents` are their maps, `remembering` what pairs of them made of each other), `findings`
//! is what it tells the agents about where they are, `listening` who else hears of the common maps, `status` what people are told, `found_out` what neighbours found, `waiting` how long agents waited for their places; `party` puts them together.

mod agents;
mod collecting;
mod company;
mod courtesy;
mod findings;
mod found_out;
mod listening;
mod party;
mod remembering;
mod scans;
mod sketching;
mod status;
mod telling;
mod waiting;

pub use fleet::findings::{Found, FoundAgent, FoundMeeting};
pub use fleet::keys::{Authority, DAYS, Keys, Validity};
pub use fleet::transport::Endpoint;
pub use listening::CommonListener;
pub use party::{Fleet, FleetOptions, OBJECTS};
pub use status::{AgentLine, LinkLine, STATUS, StatusFile, ToldFound, read_status};
pub use telling::Teller;
