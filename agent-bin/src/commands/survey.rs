//! What `loopbox info` and `loopbox run --check` say of a recording: one value, made in one place.

use super::run_scans::OpenScans;
use crate::console;
use anyhow::{Result, anyhow};
use loopbox::lidar::outlook::ScanOutlook;
use loopbox::run::Outlook;
use serde::Serialize;
use sources::correction::CameraOptions;
use sources::{FolderKind, FrameSource};
use std::fmt;
use std::path::Path;

/// What a recording holds, what a run would use of it, and why one would be refused.
#[derive(Serialize)]
#[serde(untagged)]
pub enum Survey {
    /// Of a camera's.
    Images(Outlook),
    /// Of a LiDAR's.
    Scans(ScanOutlook),
}

impl Survey {
    /// Of the images of `source`, at `path`; `fov` is the field of view that is given, degrees.
    pub fn of_images(
        mut source: Box<dyn FrameSource>,
        path: &Path,
        camera: &CameraOptions,
        fov: Option<f64>,
    ) -> Self {
        let mut outlook = Outlook::of(source.as_mut(), camera, fov);
        outlook.facts.extend(FolderKind::of(path).other().map(|other| ("also", other)));
        Self::Images(outlook)
    }

    /// Of a LiDAR's scans.
    pub fn of_scans(mut scans: OpenScans) -> Self {
        Self::Scans(scans.outlook())
    }

    /// Prints it.
    ///
    /// # Errors
    /// When it cannot be printed, and why a run would be refused.
    pub fn print(&self, json: bool) -> Result<()> {
        if json {
            console::print_json(self)?
        } else {
            console::print(&self.to_string())?
        }
        let (path, refused) = match self {
            Self::Images(outlook) => (&outlook.path, &outlook.refused),
            Self::Scans(outlook) => (&outlook.path, &outlook.refused),
        };
        match refused {
            Some(reason) if reason.contains(path.as_str()) => Err(anyhow!("a run is refused: {reason}")),
            Some(reason) => Err(anyhow!("{path}: a run is refused: {reason}")),
            None => Ok(()),
        }
    }
}

impl fmt::Display for Survey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Images(outlook) => outlook.fmt(f),
            Self::Scans(outlook) => outlook.fmt(f),
        }
    }
}
