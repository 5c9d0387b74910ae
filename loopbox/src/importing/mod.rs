//! Maps of other systems: posed keyframes with depth from elsewhere, made a map that can be merged with others.
//!
//! Two kinds of folders are read. RGB-D recordings have an image, a depth image and a pose for each keyframe, in the
//! layout of TUM or of 7-Scenes; their unit is the metre, and the map says so. COLMAP's models have images, poses and
//! sparse points with their tracks; their unit is their own.

mod build;
mod colmap;
mod rgbd;

use crate::describing::complete as find_features;
use crate::open::recording_name;
use anyhow::{Context, Result, bail};
use build::Built;
#[cfg(test)]
pub(crate) use build::semi_dense;
use map::{AgentInfo, Identity, Map};
use std::path::{Path, PathBuf};

/// How a folder of posed images is laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum Layout {
    /// TUM RGB-D: rgb.txt, depth.txt and groundtruth.txt, depth at 5000 a metre
    Tum,
    /// 7-Scenes: frame-NNNNNN.color.png, .depth.png (millimetres) and .pose.txt
    SevenScenes,
    /// A COLMAP model, text or binary, with its images
    Colmap,
}

/// How posed images become a map.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportOptions {
    /// The layout; found by what is there if not given.
    pub layout: Option<Layout>,
    /// The camera's calibration, which RGB-D folders do not bring; a `camera.yaml` in the folder is taken where none is
    /// given. COLMAP's models have their own.
    pub calibration: Option<PathBuf>,
    /// Values of a depth image that are a metre, where it is not the layout's number.
    pub depth_scale: Option<f64>,
    /// Every so many images become a keyframe, the first included. At least 1.
    pub every: usize,
    /// Whether features are found now, so that merging need not.
    pub features: bool,
}

impl Default for ImportOptions {
    fn default() -> Self {
        Self { layout: None, calibration: None, depth_scale: None, every: 1, features: true }
    }
}

/// A map of posed images.
#[derive(Clone, Debug)]
pub struct Imported {
    /// The map, of one agent called like the folder.
    pub map: Map,
    /// How the folder is laid out.
    pub layout: Layout,
    /// What is missing from it, for people.
    pub warnings: Vec<String>,
}

/// Makes a map of the posed images in `folder`.
///
/// # Errors
/// When the folder has no known layout, lacks a file, or holds one that cannot be read or does not fit the others: the
/// message names it.
pub fn import(folder: &Path, options: &ImportOptions) -> Result<Imported> {
    if options.every == 0 {
        bail!("every 0th image makes no map: give 1 or more");
    }
    if !folder.is_dir() {
        bail!("{}: is no folder", folder.display());
    }
    let layout = match options.layout.or_else(|| layout_of(folder)) {
        Some(layout) => layout,
        None => bail!(
            "{}: has no known layout\nhint: TUM RGB-D has rgb.txt, depth.txt and groundtruth.txt, 7-Scenes \
             frame-000000.color.png with .depth.png and .pose.txt, COLMAP a model (cameras, images and points3D, .txt or \
             .bin) in it, in sparse/ or in sparse/0/",
            folder.display()
        ),
    };
    let Built { camera, keyframes, edges, warnings } = match layout {
        Layout::Tum | Layout::SevenScenes => rgbd::read(folder, layout, options)?,
        Layout::Colmap => colmap::read(folder, options)?,
    };
    let mut info = AgentInfo::new(recording_name(folder), camera);
    let about = [
        ("source", folder.display().to_string()),
        ("imported", layout.name().to_owned()),
        ("program", concat!("loopbox ", env!("CARGO_PKG_VERSION")).to_owned()),
    ];
    info.provenance = about.map(|(key, value)| (key.to_owned(), value)).into();
    if layout.is_metric() {
        info.set_metric();
    }
    let first = keyframes.values().next().context("no image became a keyframe")?;
    info.identity = Some(Identity::of_recording(&camera, first.timestamp, &first.image));
    let frames = keyframes.values().map(build::frame).collect();
    let agents = [(map::AgentId::default(), info)].into();
    let mut map = Map { agents, keyframes, edges, frames, merge_provenance: Default::default() };
    if options.features {
        find_features(&mut map, None);
    }
    Ok(Imported { map, layout, warnings })
}

impl Layout {
    /// What it is called.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tum => "TUM RGB-D",
            Self::SevenScenes => "7-Scenes",
            Self::Colmap => "COLMAP",
        }
    }

    /// Whether its lengths are metres.
    fn is_metric(self) -> bool {
        self != Self::Colmap
    }
}

/// The layout of a folder, by what is there.
fn layout_of(folder: &Path) -> Option<Layout> {
    if folder.join("rgb.txt").is_file() && folder.join("depth.txt").is_file() {
        return Some(Layout::Tum);
    }
    if colmap::model_in(folder).is_some() {
        return Some(Layout::Colmap);
    }
    rgbd::has_scene_frames(folder).then_some(Layout::SevenScenes)
}
