//! One odometry or another, by name.

use crate::floam::{FeatureMethod, FeatureOdometry, NoRings};
use crate::odometry::{Odometry, OdometryParams, TrackedSweep};
use scans::Scan;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// An odometry.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Our own, against a local map of planes in continuous time: [`Odometry`].
    #[default]
    Planes,
    /// The paper's: [`FeatureMethod::Floam`].
    Floam,
    /// [`FeatureMethod::ALoam`], to compare with.
    ALoam,
}

impl Method {
    /// All methods, the default first.
    pub const ALL: [Self; 3] = [Self::Planes, Self::Floam, Self::ALoam];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Planes => "planes",
            Self::Floam => "floam",
            Self::ALoam => "a-loam",
        }
    }
}

impl fmt::Display for Method {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// There is no method of that name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no method `{0}`; known are planes, floam and a-loam")]
pub struct UnknownMethod(String);

impl FromStr for Method {
    type Err = UnknownMethod;

    fn from_str(name: &str) -> Result<Self, UnknownMethod> {
        let known = Self::ALL.into_iter().find(|method| method.name() == name);
        known.ok_or_else(|| UnknownMethod(name.to_owned()))
    }
}

/// Tracks a sensor with one of the methods.
#[derive(Clone, Debug)]
pub enum Tracker {
    /// With [`Method::Planes`].
    Planes(Box<Odometry>),
    /// With one of the others.
    Features(Box<FeatureOdometry>),
}

impl Tracker {
    /// Tracking with an empty map; `params` are those of [`Method::Planes`].
    pub fn new(method: Method, params: OdometryParams) -> Self {
        let features = |method| Self::Features(Box::new(FeatureOdometry::new(method)));
        match method {
            Method::Planes => Self::Planes(Box::new(Odometry::new(params))),
            Method::Floam => features(FeatureMethod::Floam),
            Method::ALoam => features(FeatureMethod::ALoam),
        }
    }

    /// Tracks the next scan, which must come after those before.
    ///
    /// # Errors
    /// Methods on features refuse a scan without rings.
    pub fn track(&mut self, scan: &Scan) -> Result<TrackedSweep, NoRings> {
        match self {
            Self::Planes(odometry) => Ok(odometry.track(scan)),
            Self::Features(odometry) => odometry.track(scan),
        }
    }
}
