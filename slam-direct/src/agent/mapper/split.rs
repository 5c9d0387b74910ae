//! Parts a map where its scale is not carried on: what [`Mapper::absorb`] joins.

use super::{Mapper, PROBATION, Update};
use crate::local_map::LocalMap;
use geometry::sensor::Twist;
use map::PlaceIndex;
use std::collections::BTreeSet;

impl Mapper {
    /// Adopts the depths that are under way, and these motions of keyframes.
    pub fn adopt_pending(&mut self, motions: &[(usize, Twist)]) -> Update {
        self.learn_motions(motions);
        let settled = self.adopt_depths();
        self.update(BTreeSet::new(), settled, None)
    }

    /// Takes off the keyframes behind the first `count`, with what is known of them, for a mapper of their own, whose index of places is
    /// `places`. What is under way must have been [adopted](Self::adopt_pending).
    pub fn split_off(&mut self, count: usize, mut places: Box<dyn PlaceIndex>) -> Self {
        let local = self.local.split_off(count);
        index_all(self.places.as_mut(), &self.local);
        index_all(places.as_mut(), &local);
        Self {
            places,
            closer: self.closer.split_off(count),
            depth_tasks: self.depth_tasks.split_off(count),
            calibrate_again: self.calibrate_again.map(|at| at.saturating_sub(count)),
            evaluated: PROBATION,
            barren: 0,
            local,
        }
    }
}

/// Makes the index that of a map's keyframes.
pub(in crate::agent) fn index_all(places: &mut dyn PlaceIndex, local: &LocalMap) {
    places.clear();
    for (index, state) in local.keyframes.iter().enumerate() {
        places.add(LocalMap::id(index), state.pyramid.base());
    }
}
