//! What front ends and merging share: sparse least squares over poses, the Sim(3) pose graph on it, direct Sim(3)
//! alignment of keyframes, the weighing of what tells a place from its double, and parameter structs whose documentation can be
//! printed.
//!
//! Everything here is plain functions and types of `map` and `geometry`; how a map came about, and whether an
//! edge joins keyframes of one agent or of two, is not known here.

mod block_system;
mod levenberg_marquardt;
mod parameter_check;
mod params_macro;
pub mod posegraph;
pub mod sim3_align;
pub mod verdict;

pub use block_system::{BlockSlot, BlockSystem, SystemError};
pub use levenberg_marquardt::Descent;
pub use parameter_check::{ParameterError, check_parameters, stated_range};
pub use params_macro::{DocumentedParameter, Parameter, ParameterValue};
