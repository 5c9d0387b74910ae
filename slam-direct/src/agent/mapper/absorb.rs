//! Absorbs another fragment's map, once both were found to show one place.

use super::{Mapper, Update};
use crate::agent::claim::{around, view_of_frame, view_of_keyframe};
use crate::closing;
use crate::judge::{ClaimedPlace, JudgePlace};
use crate::local_map::{Companions, LocalMap};
use crate::params::Params;
use geometry::Sim3;
use std::collections::BTreeSet;
use std::sync::Arc;

/// Two keyframes of two maps that show one place.
#[derive(Clone, Copy, Debug)]
pub(in crate::agent) struct Link {
    /// Of the map that takes in.
    pub own: usize,
    /// Of the one that is taken in.
    pub other: usize,
    /// How the worlds lie to each other.
    pub own_from_other: Sim3,
}

/// What came of it.
pub(in crate::agent) enum Absorbed {
    /// One map: the keyframes of the other came behind those of the map that took it in.
    One(Box<Mapper>, Box<Update>),
    /// They stay two, as they were: the one that was to take in, and the other.
    Two([Box<Mapper>; 2]),
}

/// What else maps are joined by.
pub(in crate::agent) struct Joined {
    /// Of the last keyframes of the map that takes in.
    pub companions: Companions,
    /// As they are now.
    pub params: Params,
    /// Who decides whether both show one place.
    pub judge: Option<Arc<dyn JudgePlace>>,
}

/// Keyframes of a map that was taken in which are judged, those nearest to the one that links them.
const CHECKED: usize = 12;

impl Mapper {
    /// Takes in the map of `other`: its keyframes come behind its own, both see each other's points where the link says
    /// so, and all are optimised. They stay two where who judges does not say that they show one place.
    pub fn absorb(mut self: Box<Self>, mut other: Box<Self>, link: &Link, with: &Joined) -> Absorbed {
        let Joined { companions, params, judge } = with;
        let count = self.local.keyframes.len();
        let mut local = self.local.clone();
        local.append(other.local.clone(), &link.own_from_other);
        let Ok(mut moved) = closing::join_places(&mut local, count + link.other, link.own, params) else {
            return Absorbed::Two([self, other]);
        };
        if let Some(judge) = judge
            && !judge.judge(&self.claim(&local, link.own)).joins()
        {
            return Absorbed::Two([self, other]);
        }
        self.local = local;
        // The last of its own keyframes have all the neighbours that they will have.
        let mut settled = self.adopt_depths();
        let behind = self.local.keyframes.len() - count;
        self.depth_tasks.begin(&self.local, companions, behind, &params.depth);
        settled.extend(self.adopt_depths());
        let of_other = other.adopt_depths();
        for index in count..self.local.keyframes.len() {
            self.local.keyframes[index].semi_dense = other.local.keyframes[index - count].semi_dense.clone();
            self.places.add(LocalMap::id(index), self.local.keyframes[index].pyramid.base());
        }
        settled.extend(of_other.into_iter().map(|keyframe| count + keyframe));
        self.depth_tasks.append(other.depth_tasks, count);
        self.closer.append(other.closer, count);
        // The others came in as they are.
        moved.retain(|&keyframe| keyframe < count);
        let update = self.update(moved, settled, None);
        Absorbed::One(self, Box::new(update))
    }

    /// That the keyframes which came behind its own into `local` show what its own around `own` do.
    fn claim(&self, local: &LocalMap, own: usize) -> ClaimedPlace {
        let count = self.local.keyframes.len();
        let others = local.covisible(own).into_iter().map(|c| c.0).filter(|k| *k >= count).take(CHECKED);
        let others: BTreeSet<usize> = others.collect();
        let frame = |(number, &k): (usize, &usize)| {
            let state = &local.keyframes[k];
            let image = state.pyramid.shared_base();
            view_of_frame(number, &image, state.camera_from_world, state.motion_in_world())
        };
        let seen = others.iter().flat_map(|&k| local.covisible(k)).map(|c| c.0);
        let near = around(local, seen.chain([own]).filter(|k| *k < count).collect());
        ClaimedPlace {
            camera: local.camera,
            sensor: local.sensor,
            keyframes: near
                .into_iter()
                .filter(|k| *k < count)
                .filter_map(|k| view_of_keyframe(local, k))
                .collect(),
            frames: others.iter().enumerate().map(frame).collect(),
        }
    }
}
