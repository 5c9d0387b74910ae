//! LiDAR SLAM: odometry, loop closure and mapping for one spinning sensor, and the merging of several agents' maps.
//!
//! The method is EMR-FLOAM (Jalil and Ibraheem, "Enhancing Multi-Robot SLAM: Centralized LiDAR-Based Loop Closure
//! Detection Approach", 2024), one module per step. The default odometry and the default merging are our own; the
//! paper's are there to compare with. Read the modules in the order of this table.
//!
//! | item | step | paper |
//! |---|---|---|
//! | [`motion::SweepMotion`] | the pose at every instant of a sweep, with a constant twist | §3.1, Eq. 2 |
//! | [`motion::MotionTable`], [`motion::Sweep::undistorted`] | points without the motion of the sensor | §3.1, Eq. 3 |
//! | [`surfaces`], [`registration`] | a local map of planes; a sweep registered against it in continuous time | ours |
//! | [`odometry`], [`degeneracy`] | the default odometry; the directions in which points do not fix the pose | ours |
//! | [`odometry::Guess`] | what of a motion the points do not determine, and the velocity carries | ours |
//! | [`features::features`] | the smoothness of a point; edges and planes of a sweep | §3.1, Eq. 1 |
//! | [`floam::FeatureOdometry`] | the paper's odometry: distortion compensated in two stages, scan to map | §3.1, Eq. 4 |
//! | [`floam::FeatureMethod::ALoam`] | A-LOAM's odometry, which the paper compares with | §5 |
//! | [`tracking`] | one of these three odometries, by name | – |
//! | [`keyframe`] | a keyframe's points, its rays and its descriptor; submaps | – |
//! | [`scan_context::ScanContext::of`] | the descriptor of a scan, and its ring key | §3.2.1, Eq. 5; §3.2.3, Eq. 9 |
//! | [`scan_context::ScanContext::similarity`] | the distance of two scans under all turns, and the yaw between them | §3.2.2, Eqs. 6–8 |
//! | [`mapping::Agent::take`] | the loop candidate, and what takes the place of the paper's threshold t | §3.2.3, Eq. 10 |
//! | [`closure::align`], [`loop_verdict::refusal`] | a loop registered, and whether its geometry and the odometry support it and no other pose does; judged as a merge is where the odometry is doubtful | ours |
//! | [`smoothing::smooth`] | the trajectory optimised over odometry and loops, in place of ISAM | §3.2.3 |
//! | [`merging::emr::propose`] | normals, Harris 3-D, FPFH, reciprocal matches, RANSAC with SVD | §4, Algorithm 1 |
//! | [`merging::merge_by`] | the relative pose of two maps and the verdict, in place of the paper's confidence | ours |
//! | `merge::merge_graph::rigid::joined` | all maps in one frame: maximum spanning tree, then all merges | §4, map-merge graph |
//! | `loopbox::lidar::merging::merge` | the union of the maps that belong together | §4, Eq. 11 |
//! | `eval::ate` | the error of a trajectory (RMSE) | §5, Eq. 12 |
//!
//! Frames: the sensor's x forward, y left, z up; metres, seconds. A pose belongs to an instant, which is stored with
//! it: the middle of its sweep. Results do not depend on the number of cores or on the order of any hash.

mod a_loam;
pub mod closure;
pub mod degeneracy;
mod feature_step;
pub mod features;
pub mod floam;
pub mod keyframe;
pub mod loop_verdict;
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
mod velocity;
pub mod voxels;

#[cfg(test)]
mod doubt_tests;
#[cfg(test)]
mod odometry_tests;
