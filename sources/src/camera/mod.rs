//! Live cameras, through the kernel's Video4Linux.
//!
//! Frames carry the driver's time stamps: seconds of the system's monotonic clock, which starts with the system and
//! is never set. If a driver uses another clock, its frames get the time at which they arrive.
//!
//! `args` has the user's options, `format` chooses the format, `node` makes the kernel's calls, `stream` owns the
//! buffers, and `controls` locks controls. `open` combines them, and `live` makes a source that survives unplugging.

pub mod args;
#[cfg(all(feature = "camera", target_os = "linux"))]
mod controls;
#[cfg(all(feature = "camera", target_os = "linux"))]
mod device;
#[cfg(all(feature = "camera", target_os = "linux"))]
mod failures;
pub mod format;
#[cfg(all(feature = "camera", target_os = "linux"))]
pub mod list;
#[cfg(all(feature = "camera", target_os = "linux"))]
mod live;
#[cfg(all(feature = "camera", target_os = "linux"))]
pub mod node;
#[cfg(all(feature = "camera", target_os = "linux"))]
mod open;
#[cfg(all(feature = "camera", target_os = "linux"))]
mod stream;

pub use args::CameraArgs;

use super::FrameSource;
use anyhow::Result;

/// Opens the camera that the user names, and starts it.
///
/// # Errors
/// When it cannot be used; says what to do about it.
#[cfg(all(feature = "camera", target_os = "linux"))]
pub fn open_camera(args: &CameraArgs) -> Result<Box<dyn FrameSource>> {
    args.check()?;
    let mut opener = open::Opener::new(args)?;
    let opened = opener.open()?;
    let reopen = args.reconnect.then(|| -> live::Reopen { Box::new(move || opener.open_again()) });
    let duration = args.duration.map(std::time::Duration::from_secs_f64);
    let path = args.path().unwrap_or_default();
    Ok(live::source(live::Live::new(path, opened, reopen, duration)))
}

/// Fails: this program was built without cameras.
///
/// # Errors
/// Always.
#[cfg(not(all(feature = "camera", target_os = "linux")))]
pub fn open_camera(_args: &CameraArgs) -> Result<Box<dyn FrameSource>> {
    Err(not_built())
}

/// The error of a program that was built without cameras.
pub fn not_built() -> anyhow::Error {
    anyhow::anyhow!(
        "this program was built without cameras\nhint: they need Linux; build there with `cargo build --release -p \
         loopbox --features camera`, or record with another tool and run the recording"
    )
}
