//! `run --ros2` and `station --ros2`: poses, points and frames published while it goes on.

use crate::console::tell;
use anyhow::Result;
use clap::Args;
#[cfg(feature = "fleet")]
use loopbox::ros::Common;
use loopbox::ros::{Follower, Publishing};

/// How a run or the common map is published.
#[cfg(feature = "ros2")]
#[derive(Debug, Args)]
pub struct Ros2Args {
    /// Publish poses, points and frames to ROS 2 as they become known, over zenoh: to the zenoh-bridge-ros2dds or router that
    /// listens there; default: tcp/127.0.0.1:7447
    #[arg(long, value_name = "ENDPOINT", num_args = 0..=1, require_equals = true,
        default_missing_value = ros2::zenoh::DEFAULT_ENDPOINT)]
    ros2: Option<ros2::zenoh::Endpoint>,
}

/// How a run or the common map is published.
#[cfg(not(feature = "ros2"))]
#[derive(Debug, Args)]
pub struct Ros2Args {
    /// This program was built without it
    #[arg(long, value_name = "ENDPOINT", num_args = 0..=1, require_equals = true, hide = true)]
    ros2: Option<Option<String>>,
}

impl Ros2Args {
    /// Whether anything is to be published.
    pub fn is_wanted(&self) -> bool {
        self.ros2.is_some()
    }

    /// Refuses what this program was built without.
    ///
    /// # Errors
    /// When publishing was asked for, and this program cannot.
    pub fn check(&self) -> Result<()> {
        #[cfg(not(feature = "ros2"))]
        if self.is_wanted() {
            anyhow::bail!(
                "--ros2: this program was built without zenoh\nhint: cargo build --release -p loopbox --features ros2 builds it with; \
                 `loopbox export MAP --ros2 FILE` writes a bag without it"
            );
        }
        Ok(())
    }

    /// Where it is to be published, if that was asked for.
    ///
    /// # Errors
    /// When zenoh refuses to begin.
    #[cfg(feature = "ros2")]
    fn outlet(&self) -> Result<Option<ros2::zenoh::Zenoh>> {
        Ok(self.ros2.as_ref().map(ros2::zenoh::Zenoh::open).transpose()?)
    }

    /// Nowhere.
    #[cfg(not(feature = "ros2"))]
    fn outlet(&self) -> Result<Option<Nowhere>> {
        self.check().map(|()| None)
    }

    /// Begins to publish a run, if that was asked for; the run is given the follower.
    ///
    /// # Errors
    /// When zenoh refuses to begin, or a thread cannot be started.
    pub fn start(&self) -> Result<Option<(Follower, Publishing)>> {
        self.outlet()?.map(Publishing::start).transpose()
    }

    /// Publishes the common map, if that was asked for.
    ///
    /// # Errors
    /// When zenoh refuses to begin.
    #[cfg(feature = "fleet")]
    pub fn common(&self) -> Result<Option<Common>> {
        Ok(self.outlet()?.map(Common::new))
    }
}

/// Publishes what is left of a run, and says what was.
///
/// # Errors
/// When publishing broke down.
pub fn end(publishing: Publishing, quiet: bool) -> Result<()> {
    let published = publishing.finish()?;
    if !quiet {
        tell!(
            "ros2: {} poses and {} clouds published; {} poses left out because the queue was full",
            published.poses,
            published.clouds + published.map_clouds,
            published.dropped
        );
    }
    Ok(())
}

/// There is nowhere to publish to.
#[cfg(not(feature = "ros2"))]
enum Nowhere {}

#[cfg(not(feature = "ros2"))]
impl ros2::Outlet for Nowhere {
    fn publish(&mut self, _topic: &str, _message: Vec<u8>) {
        match *self {}
    }
}
