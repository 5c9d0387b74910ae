//! Computes the semi-dense depth of keyframes in the background, once their neighbours are known.

use crate::background::Task;
use crate::dense::StereoJob;
use crate::depth::DepthParams;
use crate::local_map::{Companion, Companions, LocalMap};
use geometry::Swap;
use geometry::sensor::Sensor;
use map::{SemiDense, Shared};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Computes the semi-dense depths, keyframe after keyframe.
#[derive(Default)]
pub(super) struct DepthTasks {
    /// The first keyframe whose depth is not begun.
    next: usize,
    /// Depths being computed, in order of their keyframes.
    pending: Vec<(usize, Task<SemiDense>)>,
    /// The sensor by which the depth of each keyframe was begun; nothing of those that had theirs.
    by: BTreeMap<usize, Sensor>,
    /// Where depths are kept, as far as it has room.
    swap: Option<Arc<dyn Swap>>,
}

impl DepthTasks {
    /// Of a map whose first keyframes, so many, have their depth.
    pub fn from(settled: usize) -> Self {
        Self { next: settled, ..Self::default() }
    }

    /// Has depths kept by `swap`.
    pub fn swap_to(&mut self, swap: Arc<dyn Swap>) {
        self.swap = Some(swap);
    }

    /// Who keeps them.
    pub fn swap(&self) -> Option<Arc<dyn Swap>> {
        self.swap.clone()
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
            self.begin_one(local, keyframe, near, params);
        }
        self.next = self.next.max(ready);
    }

    /// The keyframes whose images prove to be off an ideal camera's by otherwise than was known when their depth was begun,
    /// and from which distance from the middle on (see [`Sensor::differs_beyond`]).
    pub fn outdated(&self, sensor: &Sensor) -> Vec<(usize, f64)> {
        let beyond = |(&keyframe, by): (&usize, &Sensor)| Some((keyframe, sensor.differs_beyond(by)?));
        self.by.iter().filter_map(beyond).collect()
    }

    /// Begins the depth of a keyframe again, beyond this distance from the middle: up to there what is `known` of it stays.
    pub fn begin_again(
        &mut self,
        local: &LocalMap,
        keyframe: usize,
        known: Shared<SemiDense>,
        beyond: f64,
        params: &DepthParams,
    ) {
        let job = StereoJob::new(local, keyframe, &[], params).beyond(local.sensor.lens, beyond, known);
        self.spawn(local, keyframe, job);
    }

    fn begin_one(&mut self, local: &LocalMap, keyframe: usize, near: &[Companion], params: &DepthParams) {
        self.spawn(local, keyframe, StereoJob::new(local, keyframe, near, params));
    }

    fn spawn(&mut self, local: &LocalMap, keyframe: usize, job: StereoJob) {
        self.by.insert(keyframe, local.sensor);
        let swap = self.swap.clone();
        let work = move || match swap {
            Some(swap) => job.run().swapped_out(&*swap),
            None => job.run(),
        };
        self.pending.push((keyframe, Task::spawn(work)));
    }

    /// Goes on behind the `count` keyframes that came before those of the map that the other was of.
    pub fn append(&mut self, other: Self, count: usize) {
        self.next = count + other.next;
        self.by.extend(other.by.into_iter().map(|(keyframe, by)| (count + keyframe, by)));
    }

    /// Parts with what it knows of the keyframes behind the first `count`; nothing may be under way.
    pub fn split_off(&mut self, count: usize) -> Self {
        let by = self.by.split_off(&count).into_iter().map(|(keyframe, by)| (keyframe - count, by)).collect();
        let later = Self { next: self.next.saturating_sub(count), by, swap: self.swap(), ..Self::default() };
        self.next = self.next.min(count);
        later
    }

    /// Returns the depths begun before, waiting for them.
    pub fn finish(&mut self) -> impl Iterator<Item = (usize, SemiDense)> + '_ {
        self.pending.drain(..).map(|(keyframe, depth)| (keyframe, depth.join()))
    }
}
