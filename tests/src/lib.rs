//! A small world of textured boxes, a renderer with exact inverse depth, camera motions, and
//! recordings written in loopbox's folder format: what tests track and map with the truth known. [`faults`] are recordings
//! to which something happens, [`doubles`] are places that share what is made in numbers. [`lidar`] does the same for a
//! spinning LiDAR; [`lidar_sites`] and [`lidar_doubles`] draw sites for one. [`proxy`] stands between processes that pair.
//!
//! All that is rendered is a function of its arguments; the same call gives the same bytes on every machine.

pub mod covered;
pub mod doubles;
pub mod faults;
pub mod lidar;
pub mod lidar_doubles;
pub mod lidar_open;
pub mod lidar_paths;
pub mod lidar_sensors;
pub mod lidar_sites;
pub mod lidar_stairs;
pub mod moving;
pub mod pages;
mod patterns;
pub mod proxy;
mod recording;
mod render;
pub mod robot;
pub mod scale;
pub mod similar_places;
pub mod streets;
mod texture;
pub mod trajectory;
mod world;

pub use recording::{Encoding, Recording, Shot, Shutter};
pub use render::{render, with_noise};
pub use texture::{Grain, Texture};
pub use world::{Cuboid, RING, World, world_from_hall};
