//! Settling keyframes: once their neighbours are known, their semi-dense depth is computed in the background.

use crate::background::Task;
use crate::dense::StereoJob;
use crate::depth::DepthParams;
use crate::local_map::{Companions, LocalMap};
use map::SemiDense;

/// Computes the semi-dense depths, keyframe after keyframe.
#[derive(Default)]
pub(super) struct Settler {
    /// The first keyframe whose depth is not begun.
    next: usize,
    /// Depths being computed, in order of their keyframes.
    settling: Vec<(usize, Task<SemiDense>)>,
}

impl Settler {
    /// Of a map whose first keyframes, so many, have their depth.
    pub fn from(settled: usize) -> Self {
        Self { next: settled, ..Self::default() }
    }

    /// The first keyframe whose depth is still to be begun, so that companions are of use to it.
    pub fn first_open(&self) -> usize {
        self.next
    }

    /// Begins the depth of the keyframes that are at least `behind` keyframes old.
    pub fn begin(&mut self, local: &LocalMap, companions: &Companions, behind: usize, params: &DepthParams) {
        let ready = local.keyframes.len().saturating_sub(behind);
        for keyframe in self.next..ready {
            let near = companions.get(&keyframe).map_or(&[][..], Vec::as_slice);
            let job = StereoJob::new(local, keyframe, near, params);
            self.settling.push((keyframe, Task::spawn(move || job.run())));
        }
        self.next = self.next.max(ready);
    }

    /// Goes on behind the `count` keyframes that came before those of the map it was of.
    pub fn behind(count: usize, other: &Self) -> Self {
        Self::from(count + other.next)
    }

    /// Takes up the depths begun before, waiting for them.
    pub fn take_up(&mut self) -> impl Iterator<Item = (usize, SemiDense)> + '_ {
        self.settling.drain(..).map(|(keyframe, depth)| (keyframe, depth.join()))
    }
}
