//! A keyframe as the alignment sees it: image and depth at each pyramid level.

use super::level_depth::LevelDepth;
use super::surface::{Surface, SurfaceParams};
use geometry::{Pinhole, Pyramid};
use map::SemiDense;
use std::sync::OnceLock;

/// Image pyramid and semi-dense depth of a keyframe, prepared once for any number of alignments.
pub struct KeyframeView {
    camera: Pinhole,
    pyramid: Pyramid,
    levels: Vec<LevelDepth>,
    /// Made when first asked for.
    surface: OnceLock<Surface>,
}

impl KeyframeView {
    /// Prepares the depth of every level of `pyramid`, of images of `camera`. Pixels outside the image and depths or
    /// variances that are not positive and finite are left out.
    pub fn new(pyramid: &Pyramid, semi_dense: &SemiDense, camera: &Pinhole) -> Self {
        let mut levels = vec![LevelDepth::base(pyramid.base().width(), pyramid.base().height(), semi_dense)];
        for level in 1..pyramid.len() {
            let image = pyramid.level(level);
            levels.push(levels[level - 1].halved(image.width(), image.height()));
        }
        Self { camera: *camera, pyramid: pyramid.clone(), levels, surface: OnceLock::new() }
    }

    /// The camera of level 0.
    pub fn camera(&self) -> &Pinhole {
        &self.camera
    }

    /// The image pyramid.
    pub fn pyramid(&self) -> &Pyramid {
        &self.pyramid
    }

    /// Number of levels.
    pub fn levels(&self) -> usize {
        self.levels.len()
    }

    /// Its surface in cells.
    pub(super) fn surface(&self) -> &Surface {
        self.surface.get_or_init(|| {
            Surface::new(&self.pyramid, &self.levels, &self.camera, &SurfaceParams::default())
        })
    }

    /// The depth at a level.
    pub(super) fn depth(&self, level: usize) -> &LevelDepth {
        &self.levels[level]
    }
}
