//! Following patches of the first frame from frame to frame.

use crate::mask::Mask;
use crate::patch::{PatchMatch, Template};
use crate::select::select;
use crate::track::{TrackParams, position_information};
use crate::warp::Warp;
use geometry::Pyramid;
use rayon::prelude::*;

/// One point being followed.
pub(super) struct Track {
    /// Pixel in the first frame.
    pub pixel: [f32; 2],
    /// Pixel in the newest frame, and its way since the one before.
    at: [f32; 2],
    velocity: [f32; 2],
    templates: Vec<Template>,
    /// Where the newest frame shows it, with the information; `None` once it is lost.
    pub seen: Option<([f32; 2], [f32; 3])>,
    /// Whether a frame did not show it; such a point is followed no more.
    pub lost: bool,
}

/// Pyramid levels over which patches are followed.
const LEVELS: usize = 4;

/// The points of the first frame that are to be followed, at most one per block of `block` pixels.
pub(super) fn choose(pyramid: &Pyramid, block: usize, mask: &Mask) -> Vec<Track> {
    let template = |pixel: [f32; 2], level: usize| {
        let warp = Warp { host_from_view: [1.0, 0.0, 0.0, 1.0], host_level: level, view_level: level };
        Template::cut(pyramid, pixel, &warp)
    };
    let begin = |pixel: [f32; 2]| {
        let templates: Vec<Template> =
            (0..LEVELS.min(pyramid.len())).map_while(|level| template(pixel, level)).collect();
        (!templates.is_empty()).then_some(Track {
            pixel,
            at: pixel,
            velocity: [0.0; 2],
            templates,
            seen: None,
            lost: false,
        })
    };
    select(pyramid.base(), block, 12.0, mask, |_, _| false).iter().filter_map(|c| begin(c.pixel)).collect()
}

/// Follows the points into the next frame; those that are not found are lost for good.
pub(super) fn follow(tracks: &mut [Track], pyramid: &Pyramid, params: &TrackParams) {
    tracks.par_iter_mut().with_min_len(32).filter(|t| !t.lost).for_each(|t| {
        let start = [t.at[0] + t.velocity[0], t.at[1] + t.velocity[1]];
        let found = [start, t.at].into_iter().find_map(|s| coarse_to_fine(&t.templates, pyramid, s, params));
        t.seen = found.map(|(found, level)| {
            (found.pixel, position_information(&found.information, found.rmse, level, params))
        });
        match t.seen {
            Some((pixel, _)) => {
                t.velocity = [pixel[0] - t.at[0], pixel[1] - t.at[1]];
                t.at = pixel;
            }
            None => t.lost = true,
        }
    });
}

/// Follows a patch from the coarsest level down; the match at level 0, or at level 1 where blur hides the
/// patch below it.
fn coarse_to_fine(
    templates: &[Template],
    pyramid: &Pyramid,
    start: [f32; 2],
    params: &TrackParams,
) -> Option<(PatchMatch, usize)> {
    let mut at = start;
    let mut best = None;
    for template in templates.iter().rev() {
        if let Some(found) = template.align(pyramid, at, 8.0, 12) {
            at = found.pixel;
            if template.level() <= 1 && found.unexplained < params.max_unexplained {
                best = Some((found, template.level()));
            }
        }
    }
    best
}
