//! What of a run is right, wrong, and reported.

use eval::{AlignMode, Associated, Pose, align};
use geometry::Sim3;
use loopbox_tests::scale::{FoundAt, scale_ratio, spread};
use measuring::median;
use nalgebra::{Rotation3, UnitQuaternion, Vector3};

/// What there is to see in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seen {
    /// A place, by its number.
    Place(usize),
    /// Nothing.
    Nothing,
}

/// Seconds that the frames of a fragment last, at least, for it to be right or wrong.
const LEAST: f64 = 0.5;
/// Metres that a camera goes in a fragment, at least, for it to be off.
const LEAST_PATH: f64 = 0.2;
/// Share of its path by which a fragment is off at most and right, and how far two scales in it may lie apart.
const OFF: f64 = 0.05;
const SCALES: f64 = 1.5;

/// A frame with a pose: what there is to see in it, its time, and where it is and was found.
#[derive(Clone, Copy, Debug)]
pub struct Posed {
    pub seen: Seen,
    pub time: f64,
    pub truth: Pose,
    pub found: Pose,
    /// Whether it had its pose when it was seen, and not only later.
    pub is_live: bool,
}

/// What became of a fragment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Fragment {
    /// Frames of each of two places.
    pub frames: [usize; 2],
    /// Frames that show nothing.
    pub invented: usize,
    /// Largest error over the length of the path, of the place with most frames; none where it goes nowhere.
    pub off: Option<f64>,
    /// Largest ratio of two scales.
    pub scales: Option<f64>,
    /// Frames of the place with fewer of them that make half a second or more.
    pub joins_places: bool,
}

impl Fragment {
    /// Whether it is not what it says to be.
    pub fn is_wrong(&self) -> bool {
        self.joins_places || self.off.is_some_and(|off| off > OFF) || self.scales.is_some_and(|r| r > SCALES)
    }
}

/// Compares the poses of a fragment with the truth; `rate` is that of the recording, frames a second.
pub fn judge(posed: &[Posed], rate: f64) -> Fragment {
    let of_place = |place| posed.iter().filter(|p| p.seen == Seen::Place(place)).copied().collect::<Vec<_>>();
    let places = [of_place(0), of_place(1)];
    let frames = [places[0].len(), places[1].len()];
    let (most, fewest) =
        if frames[0] >= frames[1] { (&places[0], frames[1]) } else { (&places[1], frames[0]) };
    let least = (LEAST * rate) as usize;
    let invented = posed.iter().filter(|p| p.seen == Seen::Nothing).count();
    let joins_places = fewest >= least;
    if most.len() < least {
        return Fragment { frames, invented, joins_places, ..Fragment::default() };
    }
    Fragment { frames, invented, joins_places, off: off(most), scales: scales(most, rate) }
}

/// Largest distance from the truth over the length of the path, after one similarity.
fn off(posed: &[Posed]) -> Option<f64> {
    let path: f64 = posed.windows(2).map(|w| (w[1].truth.translation - w[0].truth.translation).norm()).sum();
    if path < LEAST_PATH {
        return None;
    }
    let (found, truth) = aligned(posed)?.positions();
    found.iter().zip(&truth).map(|(a, b)| (a - b).norm() / path).reduce(f64::max)
}

/// Between where frames after the second of two times are found and where they are, from the nearest frame before the first one:
/// median, metres; none where the fragment does not hold both.
pub fn gap(posed: &[Posed], (first, last): (f64, f64)) -> Option<f64> {
    let (found, truth) = aligned(posed)?.positions();
    let frames = |is_asked: &dyn Fn(&Posed) -> bool| {
        (0..posed.len()).filter(|&i| is_asked(&posed[i])).collect::<Vec<_>>()
    };
    let (begin, end) = (frames(&|p| p.time < first), frames(&|p| p.time > last));
    let gap_of = |i: usize| {
        let off = |j: &&usize| (truth[i] - truth[**j]).norm();
        let j = *begin.iter().min_by(|a, b| off(a).total_cmp(&off(b)))?;
        Some(((found[i] - found[j]) - (truth[i] - truth[j])).norm())
    };
    median(end.into_iter().filter_map(gap_of).collect())
}

/// Frames that had no pose when they were seen, beside those that had.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FoundLater {
    pub frames: usize,
    /// Those that are [`TIMES`] as far off as live ones, in position or direction.
    pub off: usize,
    /// RMS errors of live ones, metres and radians.
    pub live: [f64; 2],
    /// Largest errors of live ones, in units of these.
    pub most_live: [f64; 2],
    /// Largest errors of those found later, in units of the live ones' RMS errors.
    pub most: [f64; 2],
}

/// Live poses' RMS errors by which one that is found later is off at most and right.
pub const TIMES: f64 = 3.0;

/// Compares frames that were found later with live ones, after the similarity that fits these; none where there are not both.
pub fn found_later(posed: &[Posed]) -> Option<FoundLater> {
    let (live, later): (Vec<Posed>, Vec<Posed>) = posed.iter().partition(|p| p.is_live);
    if later.is_empty() || live.len() < 3 {
        return None;
    }
    let pairs = associated(&live);
    let fit = fit(&pairs)?;
    let moved = |posed: &[Posed]| -> Vec<[Vector3<f64>; 2]> {
        let moved = associated(posed).transformed(&fit);
        let turn = |a: &Pose, b: &Pose| Rotation3::from_matrix_unchecked(a.rotation * b.rotation.transpose());
        let each = moved.estimate.iter().zip(&moved.truth);
        each.map(|(a, b)| [a.translation - b.translation, turn(a, b).scaled_axis()]).collect()
    };
    let (live, later) = (moved(&live), moved(&later));
    // Positions along a line leave a turn about it open.
    let turn = live.iter().map(|e| e[1]).sum::<Vector3<f64>>() / live.len() as f64;
    let errors = |moved: &[[Vector3<f64>; 2]]| -> Vec<[f64; 2]> {
        moved.iter().map(|[shift, turned]| [shift.norm(), (turned - turn).norm()]).collect()
    };
    let live = errors(&live);
    let rms = [0, 1].map(|i| (live.iter().map(|e| e[i] * e[i]).sum::<f64>() / live.len() as f64).sqrt());
    let relative = |errors: Vec<[f64; 2]>| -> Vec<[f64; 2]> {
        errors.iter().map(|e| [e[0] / rms[0], e[1] / rms[1]]).collect()
    };
    let most = |relative: &[[f64; 2]]| [0, 1].map(|i| relative.iter().map(|e| e[i]).fold(0.0, f64::max));
    let (later, live) = (relative(errors(&later)), relative(live));
    let off = later.iter().filter(|e| e[0].max(e[1]) > TIMES).count();
    Some(FoundLater { frames: later.len(), off, live: rms, most_live: most(&live), most: most(&later) })
}

/// Frames moved by the similarity that fits the truth.
fn aligned(posed: &[Posed]) -> Option<Associated> {
    let pairs = associated(posed);
    Some(pairs.transformed(&fit(&pairs)?))
}

fn associated(posed: &[Posed]) -> Associated {
    Associated {
        timestamps: Some(posed.iter().map(|p| p.time).collect()),
        estimate: posed.iter().map(|p| p.found).collect(),
        truth: posed.iter().map(|p| p.truth).collect(),
    }
}

/// The similarity that fits the truth.
fn fit(pairs: &Associated) -> Option<Sim3> {
    align(pairs, AlignMode::Sim3).map_or_else(|_| along_a_line(pairs), |(fit, _)| Some(fit))
}

/// The similarity of a drive along a line, whose positions leave a turn about it open: errors do not depend on that turn.
fn along_a_line(pairs: &Associated) -> Option<Sim3> {
    let (found, truth) = pairs.positions();
    let direction = |points: &[Vector3<f64>]| Some(points.last()? - points.first()?);
    let rotation = UnitQuaternion::rotation_between(&direction(&found)?, &direction(&truth)?)?;
    let scale = spread(&truth) / spread(&found);
    let mean = |points: &[Vector3<f64>]| points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    scale.is_finite().then(|| Sim3::new(rotation, mean(&truth) - rotation * mean(&found) * scale, scale))
}

/// Largest ratio of the scales of two stretches, each over the truth.
fn scales(posed: &[Posed], rate: f64) -> Option<f64> {
    let found = |p: &Posed| FoundAt { time: p.time, found: p.found.translation, truth: p.truth.translation };
    scale_ratio(&posed.iter().map(found).collect::<Vec<_>>(), rate)
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Se3;

    /// Ten seconds at ten frames a second along an arc of two metres; `found` says where a frame is found, of its number and its truth.
    fn drive(
        seen: impl Fn(usize) -> Seen,
        found: impl Fn(usize, Vector3<f64>) -> Vector3<f64>,
    ) -> Vec<Posed> {
        let pose = |at| Pose::from(Se3::new(UnitQuaternion::identity(), at));
        let frame = |i: usize| {
            let angle = 0.02 * i as f64;
            let truth = Vector3::new(angle.sin(), 0.0, angle.cos());
            let (truth, found) = (pose(truth), pose(found(i, truth)));
            Posed { seen: seen(i), time: 0.1 * i as f64, truth, found, is_live: true }
        };
        (0..100).map(frame).collect()
    }

    #[test]
    fn a_fragment_in_another_unit_is_right() {
        let fragment = judge(&drive(|_| Seen::Place(0), |_, at| at * 7.0), 10.0);
        assert!(!fragment.is_wrong() && fragment.off.unwrap() < 1e-9, "{fragment:?}");
        assert!(fragment.scales.unwrap() < 1.0 + 1e-9 && fragment.frames == [100, 0]);
    }

    #[test]
    fn a_scale_that_changes_midway_is_wrong() {
        let middle = Vector3::new(1f64.sin(), 0.0, 1f64.cos());
        let shrunk = |i: usize, at: Vector3<f64>| if i < 50 { at } else { middle + (at - middle) * 0.5 };
        let fragment = judge(&drive(|_| Seen::Place(0), shrunk), 10.0);
        assert!(fragment.scales.unwrap() > 1.9 && fragment.is_wrong(), "{fragment:?}");
    }

    #[test]
    fn a_drive_along_a_line_has_an_error_too() {
        let mut line = drive(|_| Seen::Place(0), |i, _| Vector3::x() * (0.5 * i as f64));
        line.iter_mut().enumerate().for_each(|(i, p)| p.truth.translation = Vector3::x() * (0.02 * i as f64));
        assert!(judge(&line, 10.0).off.unwrap() < 1e-9);
        line[50].found.translation.x += 10.0;
        assert!(judge(&line, 10.0).off.unwrap() > 0.1);
    }

    #[test]
    fn a_frame_found_later_is_off_in_units_of_live_ones() {
        let wobble =
            |i: usize, at: Vector3<f64>| at + Vector3::y() * if i.is_multiple_of(2) { 0.01 } else { -0.01 };
        let tilted = |angle: f64| *Rotation3::from_euler_angles(angle, 0.0, 0.0).matrix();
        let mut posed = drive(|_| Seen::Place(0), wobble);
        assert_eq!(found_later(&posed), None);
        posed.iter_mut().enumerate().for_each(|(i, p)| {
            p.is_live = i >= 10;
            p.found.rotation = tilted(if i.is_multiple_of(2) { 0.01 } else { -0.01 });
        });
        let right = found_later(&posed).unwrap();
        assert!((right.frames, right.off) == (10, 0) && (right.live[0] - 0.01).abs() < 1e-3, "{right:?}");
        posed[3].found.translation.y += 0.1;
        posed[5].found.rotation = tilted(0.05);
        let off = found_later(&posed).unwrap();
        assert!(off.off == 2 && off.most[0] > 8.0 && (4.0..6.0).contains(&off.most[1]), "{off:?}");
    }

    #[test]
    fn the_gap_of_a_drive_that_comes_back_is_what_it_drifted() {
        let pose = |at| Pose::from(Se3::new(UnitQuaternion::identity(), at));
        let drive = |drift: f64| -> Vec<Posed> {
            let frame = |i: usize| {
                let angle = 0.1 * i as f64;
                let truth = Vector3::new(angle.sin(), 0.0, angle.cos()) * 10.0;
                let found = truth * 0.3 + Vector3::y() * (0.3 * drift * i as f64 / 70.0);
                let (truth, found) = (pose(truth), pose(found));
                Posed { seen: Seen::Place(0), time: 0.1 * i as f64, truth, found, is_live: true }
            };
            (0..70).map(frame).collect()
        };
        assert!(gap(&drive(0.0), (0.6, 6.5)).unwrap() < 1e-9);
        let off = gap(&drive(1.0), (0.6, 6.5)).unwrap();
        assert!((0.7..1.1).contains(&off), "{off}");
        assert_eq!(gap(&drive(1.0)[20..], (0.6, 6.5)), None);
    }

    #[test]
    fn a_step_aside_is_wrong_and_so_are_two_places_in_one_map() {
        let aside = |i: usize, at: Vector3<f64>| if i < 95 { at } else { at + Vector3::y() * 0.3 };
        assert!(judge(&drive(|_| Seen::Place(0), aside), 10.0).off.unwrap() > 0.1);
        let seen = |i: usize| if i < 60 { Seen::Place(0) } else { Seen::Place(1) };
        let fragment = judge(&drive(seen, |_, at| at), 10.0);
        assert!(fragment.joins_places && fragment.is_wrong() && fragment.off.unwrap() < 1e-9);
        let few = |i: usize| if i < 97 { Seen::Place(0) } else { Seen::Nothing };
        let fragment = judge(&drive(few, |_, at| at), 10.0);
        assert!(fragment.invented == 3 && !fragment.is_wrong());
    }
}
