//! Agents that pair over a network, with or without a station.
//!
//! **Only states are pushed, objects are pulled.** What an agent's map consists of are immutable objects, called by their
//! content ([`manifest`], [`hash`]); neighbours say which version of a map they have ([`wire`]) and ask each other for
//! the parts of objects that they lack. So a message that is lost, comes twice or late does no harm, and who was away
//! goes on where it was.
//!
//! To read in this order: `manifest` (what a map consists of), `publishing` and `assembling` (a map as objects and back),
//! `lossy_codec` (the few bytes by which maps meet), `store` (where they are kept), `wire` (what neighbours say), `merge_results` (what they found out), `keys` (who is
//! believed), `node` (what one says and does, as a function of what
//! comes and of the time), `link` (how much is asked for at once), `transport` and `service` (sockets, threads, clocks).

pub mod assembling;
pub mod bytes;
#[cfg(test)]
mod faults;
pub mod hash;
pub mod keys;
mod link;
pub mod lossy_codec;
pub mod manifest;
pub mod merge_results;
pub mod node;
pub mod publishing;
pub mod service;
pub mod store;
#[cfg(test)]
mod test_support;
#[cfg(test)]
mod tests;
pub mod transport;
pub mod wire;
