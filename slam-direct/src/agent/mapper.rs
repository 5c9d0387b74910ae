//! Mapping: the work after a new keyframe, as a function of the map and a [`Job`]. It may run in the background.

mod absorb;
mod split;

pub(super) use absorb::{Absorbed, Joined, Link};
pub(super) use split::index_all;

use super::depth_tasks::DepthTasks;
use crate::closing::LoopCloser;
use crate::depth::has_hardly_any;
use crate::local_map::{Companions, Counts, KeyframeState, LocalMap, Matched};
use crate::mapping;
use crate::mask::Mask;
use crate::params::Params;
use crate::publish;
use geometry::sensor::Twist;
use geometry::{Pinhole, Swap};
use map::{Edge, EdgeKind, KeyframeId, MapDelta, PlaceIndex, SemiDense, Settled};
use std::collections::BTreeSet;
use std::sync::Arc;

/// A frame that becomes a keyframe, and what was learnt since the one before.
pub(super) struct Job {
    pub keyframe: KeyframeState,
    /// Points of the map that it sees.
    pub matched: Vec<Matched>,
    pub counts: Counts,
    /// Motion of keyframes, as the frames on both sides of each tell it.
    pub motions: Vec<(usize, Twist)>,
    pub companions: Companions,
    /// What moves with the camera.
    pub mask: Arc<Mask>,
    /// Readout times of a rolling shutter that was found since.
    pub readout: Option<[f64; 2]>,
    /// As they are now: some are learnt while tracking.
    pub params: Params,
}

/// What came of a job.
pub(super) struct Update {
    /// The map as it is now, to track against.
    pub view: LocalMap,
    /// What changed in the map as it is handed out; without number.
    pub delta: MapDelta,
    /// All loops closed so far.
    pub closed: Vec<Edge>,
    /// The loop that was closed, `(newer, older)` keyframe.
    pub closed_loop: Option<(KeyframeId, KeyframeId)>,
    /// The first keyframe for which companions are of use.
    pub first_open: usize,
    /// Whether it is of use.
    pub map_quality: MapQuality,
}

/// Keyframes that are as new keep their pyramids: twice as many as a frame's points are sought in, for a camera that
/// turns back.
const RECENT: usize = 50;

/// Older keyframes that are looked at in turn for whether they rest, at each new one.
const RESTED: usize = 64;

/// Keyframes at the begin of a map whose depths say whether it is of use: where the poses are wrong, edges are found at no place that
/// agrees with them. One such keyframe may be blurred, or come of a turn.
const PROBATION: usize = 3;

/// Depths that are computed again before it is asked whether to stop.
const AT_ONCE: usize = 16;

/// The owner of the map at work.
pub(super) struct Mapper {
    pub local: LocalMap,
    pub places: Box<dyn PlaceIndex>,
    closer: LoopCloser,
    depth_tasks: DepthTasks,
    /// Keyframes from which on the sensor is asked after again.
    calibrate_again: Option<usize>,
    /// How many of its first keyframes were looked at for whether the map is of use, and how many of them have hardly any depth.
    evaluated: usize,
    barren: usize,
}

/// What the first keyframes' depths say of a map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum MapQuality {
    /// They are not known yet.
    #[default]
    Open,
    /// It is of use.
    Kept,
    /// Its poses are wrong: none of them found depth.
    Broken,
}

/// The threads that mapping beside the tracking uses, so that the tracker does not queue behind it: all cores but one.
/// `None` when the system gives no threads; mapping then shares the tracker's.
pub(super) fn own_threads() -> Option<rayon::ThreadPool> {
    let threads = rayon::current_num_threads().saturating_sub(1).max(1);
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().ok()
}

impl Mapper {
    /// A mapper with an empty map.
    pub fn new(camera: Pinhole, places: Box<dyn PlaceIndex>) -> Self {
        let (closer, depth_tasks) = (LoopCloser::default(), DepthTasks::default());
        let local = LocalMap::new(camera);
        Self { local, places, closer, depth_tasks, calibrate_again: None, evaluated: 0, barren: 0 }
    }

    /// A mapper that goes on in a map: `local` is the working form of one with these edges.
    pub fn resume(local: LocalMap, places: Box<dyn PlaceIndex>, edges: &[Edge]) -> Self {
        let closed = edges.iter().filter(|edge| edge.kind == EdgeKind::Loop).cloned().collect();
        let (closer, depth_tasks) = (LoopCloser::of(closed), DepthTasks::from(local.keyframes.len()));
        Self { local, places, closer, depth_tasks, calibrate_again: None, evaluated: PROBATION, barren: 0 }
    }

    /// Has the keyframes' depths kept by `swap`.
    pub fn swap_to(&mut self, swap: Arc<dyn Swap>) {
        self.depth_tasks.swap_to(swap);
    }

    /// The loops that were closed.
    pub fn closed(&self) -> &[Edge] {
        self.closer.closed()
    }

    /// Whether a loop is being closed.
    pub fn closes_a_loop(&self) -> bool {
        self.closer.is_busy()
    }

    /// The first keyframe for which companions are of use.
    pub fn first_open(&self) -> usize {
        self.depth_tasks.first_open()
    }

    /// Drops the map to start anew; what it taught of the sensor stays.
    pub fn forget(self) -> Self {
        let mut places = self.places;
        places.clear();
        let mut fresh = Self::new(self.local.camera, places);
        fresh.local.sensor = self.local.sensor;
        if let Some(swap) = self.depth_tasks.swap() {
            fresh.swap_to(swap);
        }
        fresh
    }

    /// Takes over a first map of two keyframes, and its sensor.
    pub fn adopt(&mut self, first: LocalMap, params: &Params) -> Update {
        self.local = first;
        self.places.add(LocalMap::id(0), self.local.keyframes[0].pyramid.base());
        let moved = self.map_around(1, &Counts::default(), params);
        self.update(moved, Vec::new(), None)
    }

    /// Whether the next keyframe sets off more than what concerns its surroundings: the end of a loop's closing, or an
    /// optimisation of the whole map for its sensor.
    pub fn has_much_to_do(&self, params: &Params) -> bool {
        let next = self.local.keyframes.len() + 1;
        self.closes_a_loop() || mapping::calibration_is_due(next, self.calibrate_again, &params.mapping)
    }

    /// Extends the map by a keyframe; takes up what was begun in the background at the one before, and begins more.
    pub fn extend(&mut self, job: Job) -> Update {
        let Job { keyframe, matched, counts, motions, companions, mask, readout, params } = job;
        self.local.mask = mask;
        self.learn_motions(&motions);
        let keyframe = self.local.push(keyframe);
        mapping::add_observations(&mut self.local, keyframe, &matched);
        mapping::cull_masked(&mut self.local, keyframe);
        let mut moved = self.map_around(keyframe, &counts, &params);
        moved.extend(self.learn_readout(readout, &params));
        let settled = self.adopt_depths();
        let closed_loop = self.adopt_loop(&mut moved, &params);
        self.detect_loops(&settled, &params);
        self.depth_tasks.begin(&self.local, &companions, params.mapping.depth_delay, &params.depth);
        self.rest_far(keyframe);
        self.update(moved, settled, closed_loop)
    }

    /// Takes over the readout times of a sensor that was taken to be read at once; gives the keyframes that it moved.
    fn learn_readout(&mut self, readout: Option<[f64; 2]>, params: &Params) -> Vec<usize> {
        let Some(readout) = readout.filter(|_| !self.local.sensor.is_rolling()) else { return Vec::new() };
        let (p, before) = (&params.mapping, self.local.sensor);
        self.local.set_sensor(before.with_readout(readout));
        let changes = mapping::optimise_all(&mut self.local, p.calibration_iterations, p, &|| false);
        let count = self.local.keyframes.len();
        self.calibrate_again = mapping::calibrate_again(count, &before, &self.local.sensor);
        changes.into_iter().map(|change| change.keyframe).collect()
    }

    fn learn_motions(&mut self, motions: &[(usize, Twist)]) {
        for &(keyframe, motion) in motions {
            self.local.keyframes[keyframe].motion = motion;
        }
    }

    /// Ends the run: what is in the background, depth and loops of the last keyframes, the last optimisation of the
    /// whole map, which `stop` ends early. Gives the loops closed in doing so.
    pub fn finish(
        &mut self,
        motions: &[(usize, Twist)],
        companions: &Companions,
        params: &Params,
        stop: &dyn Fn() -> bool,
    ) -> (Update, Vec<(KeyframeId, KeyframeId)>) {
        self.learn_motions(motions);
        let mut moved = BTreeSet::new();
        let mut settled = self.adopt_depths();
        let mut loops: Vec<_> = self.adopt_loop(&mut moved, params).into_iter().collect();
        self.depth_tasks.begin(&self.local, companions, 0, &params.depth);
        settled.extend(self.adopt_depths());
        for &keyframe in &settled {
            if stop() {
                break;
            }
            self.detect_loops(&[keyframe], params);
            loops.extend(self.adopt_loop(&mut moved, params));
        }
        if self.local.keyframes.len() > 1 && !stop() {
            let p = &params.mapping;
            mapping::optimise_all(&mut self.local, p.final_iterations, p, stop);
            moved = (0..self.local.keyframes.len()).collect();
        }
        for again in self.depth_tasks.outdated(&self.local.sensor).chunks(AT_ONCE) {
            if stop() {
                break;
            }
            for &(keyframe, beyond) in again {
                let known = self.local.keyframes[keyframe].semi_dense.clone();
                self.depth_tasks.begin_again(&self.local, keyframe, known, beyond, &params.depth);
            }
            settled.extend(self.adopt_depths());
        }
        (self.update(moved, settled, None), loops)
    }

    /// New points for a keyframe and its nearest neighbour, then the joint optimisation around it; gives the
    /// keyframes that it moved.
    fn map_around(&mut self, keyframe: usize, counts: &Counts, params: &Params) -> BTreeSet<usize> {
        let p = params;
        let mut others: Vec<usize> = self.local.covisible(keyframe).into_iter().map(|c| c.0).collect();
        others.truncate(p.mapping.search_views);
        if let Some(&nearest) = others.first() {
            mapping::add_points(&mut self.local, nearest, &[keyframe], &p.mapping, &p.triangulate, &p.track);
        }
        mapping::add_points(&mut self.local, keyframe, &others, &p.mapping, &p.triangulate, &p.track);
        let mut changes = mapping::optimise_around(&mut self.local, keyframe, &p.mapping);
        let count = self.local.keyframes.len();
        if mapping::calibration_is_due(count, self.calibrate_again, &p.mapping) {
            let before = self.local.sensor;
            changes.extend(mapping::calibrate(&mut self.local, &p.mapping));
            self.calibrate_again = mapping::calibrate_again(count, &before, &self.local.sensor);
        }
        self.local.count(counts);
        mapping::cull_unfound(&mut self.local, counts.hosts(), 0.25);
        self.places.add(LocalMap::id(keyframe), self.local.keyframes[keyframe].pyramid.base());
        changes.into_iter().map(|change| change.keyframe).collect()
    }

    /// Lets the pyramids and depths rest of keyframes that are neither recent nor near `keyframe`, which it sees points
    /// with: of those that were recent not long ago at once; of all others, which somebody may have looked at since in search of a
    /// loop, in turn, so that a keyframe costs what it costs however many there are.
    fn rest_far(&mut self, keyframe: usize) {
        let near: BTreeSet<usize> = self.local.covisible(keyframe).into_iter().map(|c| c.0).collect();
        let far = keyframe.saturating_sub(RECENT);
        let round_robin: Vec<usize> = (0..far.min(RESTED)).map(|i| (keyframe * RESTED + i) % far).collect();
        let lately = far.saturating_sub(RECENT)..far;
        for far in lately.chain(round_robin.iter().copied()).filter(|far| !near.contains(far)) {
            // Looked at first: what is not changed stays shared.
            if !self.local.keyframes[far].pyramid.is_resting() {
                self.local.keyframes[far].rest();
            }
        }
        for far in round_robin.into_iter().filter(|far| !near.contains(far)) {
            publish::keyframe(&self.local, far).rest();
        }
    }

    /// Adopts the depths begun before; gives their keyframes.
    fn adopt_depths(&mut self) -> Vec<usize> {
        let mut settled = Vec::new();
        let depths: Vec<_> = self.depth_tasks.finish().collect();
        for (keyframe, depth) in depths {
            if keyframe == self.evaluated && keyframe < PROBATION {
                self.judge(keyframe, &depth);
            }
            self.local.keyframes[keyframe].semi_dense = depth.into();
            settled.push(keyframe);
        }
        settled
    }

    /// Looks at whether one of the first keyframes has depth.
    fn judge(&mut self, keyframe: usize, depth: &SemiDense) {
        self.evaluated += 1;
        let image = self.local.keyframes[keyframe].pyramid.shared_base();
        self.barren += usize::from(has_hardly_any(&image, depth.len()));
    }

    fn map_quality(&self) -> MapQuality {
        match (self.evaluated, self.barren) {
            (..PROBATION, _) => MapQuality::Open,
            (_, PROBATION..) => MapQuality::Broken,
            _ => MapQuality::Kept,
        }
    }

    /// Seeks a loop from keyframes that have just settled, and begins to close it.
    fn detect_loops(&mut self, settled: &[usize], params: &Params) {
        if self.closer.is_busy() {
            return;
        }
        let (local, places) = (&self.local, self.places.as_ref());
        let found = settled.iter().find_map(|&k| self.closer.find(local, places, k, params));
        if let Some(found) = found {
            self.closer.start(&self.local, found, params);
        }
    }

    /// Adopts the loop being closed, if there is one.
    fn adopt_loop(
        &mut self,
        moved: &mut BTreeSet<usize>,
        params: &Params,
    ) -> Option<(KeyframeId, KeyframeId)> {
        let (found, by_loop) = self.closer.finish(&mut self.local, params)?.ok()?;
        moved.extend(by_loop);
        Some(found.keyframes())
    }

    fn update(
        &self,
        moved: BTreeSet<usize>,
        settled: Vec<usize>,
        closed_loop: Option<(KeyframeId, KeyframeId)>,
    ) -> Update {
        let settled = settled.into_iter().map(|keyframe| Settled {
            keyframe: LocalMap::id(keyframe),
            semi_dense: self.local.keyframes[keyframe].semi_dense.clone(),
            points: publish::points(&self.local, keyframe),
        });
        let delta = MapDelta {
            moved: moved.into_iter().map(|keyframe| publish::moved(&self.local, keyframe)).collect(),
            settled: settled.collect(),
            ..MapDelta::default()
        };
        let (closed, first_open) = (self.closer.closed().to_vec(), self.first_open());
        Update {
            view: self.local.clone(),
            delta,
            closed,
            closed_loop,
            first_open,
            map_quality: self.map_quality(),
        }
    }
}

#[cfg(test)]
mod tests;
