//! LiDAR agents: a spinning sensor tracks itself, finds places again, and maps what it sees.
//!
//! The method is EMR-FLOAM (Jalil and Ibraheem, "Enhancing Multi-Robot SLAM: Centralized LiDAR-Based Loop Closure
//! Detection Approach", 2024), one module per step, with an odometry of our own as the default.
//!
//! Read in this order: [`motion`] (sweeps and their distortion, Eq. 2–3), [`surfaces`] (the local map),
//! [`registration`] (a sweep against it), [`odometry`] (the default), [`degeneracy`]; [`features`] and
//! [`floam`] (the paper's odometry), [`tracking`] (one or the other); [`keyframe`], [`scan_context`], [`closure`] (places found again), [`smoothing`] and
//! [`mapping`] (the agent); [`merging`] (maps of several agents).
//!
//! Frames: the sensor's x forward, y left, z up; metres, seconds. A pose belongs to an instant, which is stored with
//! it: the middle of its sweep. Results do not depend on the number of cores or on the order of any hash.

mod a_loam;
pub mod closure;
pub mod degeneracy;
pub mod features;
pub mod floam;
pub mod keyframe;
pub mod mapping;
pub mod merging;
pub mod motion;
pub mod odometry;
pub mod point_grid;
pub mod registration;
pub mod scan_context;
pub mod smoothing;
mod start;
pub mod surfaces;
pub mod tracking;
pub mod voxels;

#[cfg(test)]
mod odometry_tests;
