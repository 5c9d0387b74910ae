//! Agents that pair over a network, with or without a station: what a run and a station do with the crate `fleet`.
//!
//! `publishing` tells a run's map while it grows. `prefetch` says what of others' is worth fetching first and when enough of
//! it is here, and which of two agents looks at it, `components` who hangs together, `collecting`
//! merges the maps that come, in batches, and keeps the common map on disk (`scans` those of LiDARs; `agents` are their maps, `remembering` what pairs of them made of each other), `common_maps` is what both share, `merge_results`
//! is what it tells the agents about where they are, `common_listener` who else hears of the common maps, `status` what people are told, `received_results` what neighbours found, `saying` what is said as they come and go, `waiting` how long agents waited for their places; `fleet_node` puts them together.

mod agents;
mod collecting;
mod common_listener;
mod common_maps;
mod components;
mod fleet_node;
mod merge_results;
mod options;
mod prefetch;
mod publishing;
mod received_results;
mod remembering;
mod saying;
mod scans;
mod status;
mod waiting;

pub use common_listener::CommonListener;
pub use fleet::keys::{Authority, DAYS, Keys, Validity};
pub use fleet::merge_results::{MergeResults, PairVerdict, PlacedAgent};
pub use fleet::transport::Endpoint;
pub use fleet_node::{Fleet, OBJECTS};
pub use options::FleetOptions;
pub use publishing::MapPublisher;
pub use status::{AgentLine, LinkLine, RemoteResults, STATUS, StatusFile, read_status};
