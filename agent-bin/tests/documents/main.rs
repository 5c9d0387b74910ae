//! README and book: their links, their commands, the outputs they show, their generated pages and their tables.
//!
//! The pages describe the program with its default features.
#![cfg(all(
    feature = "camera",
    feature = "fleet",
    feature = "foxglove-server",
    feature = "sqlite",
    feature = "view"
))]

#[path = "../common/mod.rs"]
mod common;

mod annotating;
mod commands;
mod generated;
mod invariants;
mod links;
mod markdown;
mod outputs;
mod prose;
mod tables;
