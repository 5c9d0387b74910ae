//! The ordered pairs (host, observing frame) that occur in a problem: what depends on a relative pose is computed
//! once for each, however many points the two share.

use super::problem::Problem;
use geometry::Se3;
use nalgebra::{Matrix3, Vector3};

/// The pairs, in order of host and frame, and which one each observation belongs to.
pub(crate) struct Pairs {
    /// `(host, frame)`, indices into `Problem::frames`.
    pub ends: Vec<(usize, usize)>,
    of: Vec<u32>,
}

/// A relative pose `frame_from_host`.
pub(crate) struct Relative {
    pub pose: Se3,
    pub rotation: Matrix3<f64>,
}

impl Relative {
    /// Where a point of the host lies in the frame, times its inverse depth.
    #[inline]
    pub fn transform(&self, ray: &Vector3<f64>, inverse_depth: f64) -> Vector3<f64> {
        self.rotation * ray + self.pose.translation * inverse_depth
    }
}

impl Pairs {
    /// The pairs of a problem.
    pub fn new(problem: &Problem) -> Self {
        let mut observers: Vec<Vec<u32>> = vec![Vec::new(); problem.frames.len()];
        for point in &problem.points {
            let frames = problem.observations[point.observations.clone()].iter().map(|o| o.frame as u32);
            observers[point.host].extend(frames);
            if observers[point.host].len() > 64 * problem.frames.len() {
                sort_out(&mut observers[point.host]);
            }
        }
        observers.iter_mut().for_each(sort_out);
        let mut first = Vec::with_capacity(observers.len());
        let mut ends = Vec::new();
        for (host, frames) in observers.iter().enumerate() {
            first.push(ends.len());
            ends.extend(frames.iter().map(|&frame| (host, frame as usize)));
        }
        let mut of = vec![0; problem.observations.len()];
        for point in &problem.points {
            for i in point.observations.clone() {
                let frame = problem.observations[i].frame as u32;
                of[i] = (first[point.host] + observers[point.host].partition_point(|&f| f < frame)) as u32;
            }
        }
        Self { ends, of }
    }

    /// The pair of an observation.
    #[inline]
    pub fn of(&self, observation: usize) -> usize {
        self.of[observation] as usize
    }

    /// The relative pose of each pair when the frames stand at `frames`.
    pub fn relative(&self, frames: &[Se3]) -> Vec<Relative> {
        let inverse: Vec<Se3> = frames.iter().map(Se3::inverse).collect();
        let relative = |&(host, frame): &(usize, usize)| {
            let pose = frames[frame] * inverse[host];
            Relative { pose, rotation: pose.rotation_matrix() }
        };
        self.ends.iter().map(relative).collect()
    }
}

fn sort_out(frames: &mut Vec<u32>) {
    frames.sort_unstable();
    frames.dedup();
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::window::tests::scene;

    #[test]
    fn only_pairs_that_occur_are_kept() {
        let mut problem = scene(5, 30, &[0]);
        // Frame 4 is seen by nobody and sees nothing.
        problem.points.retain(|p| p.host != 4);
        problem.points.iter_mut().for_each(|p| {
            let seen = problem.observations[p.observations.clone()].iter();
            p.observations.end = p.observations.start + seen.take_while(|o| o.frame != 4).count();
        });
        let pairs = Pairs::new(&problem);
        assert!(pairs.ends.windows(2).all(|w| w[0] < w[1]), "{:?}", pairs.ends);
        assert!(pairs.ends.iter().all(|&(host, frame)| host != frame && host < 4 && frame < 4));
        let relative = pairs.relative(&problem.frames);
        for point in &problem.points {
            for i in point.observations.clone() {
                let (host, frame) = pairs.ends[pairs.of(i)];
                assert_eq!((host, frame), (point.host, problem.observations[i].frame));
                let expected = problem.frames[frame] * problem.frames[host].inverse();
                assert_eq!(relative[pairs.of(i)].pose, expected);
            }
        }
    }
}
