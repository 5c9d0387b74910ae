//! Taking in another fragment's map, once both were seen to show one place.

use super::{Mapper, Update};
use crate::closing;
use crate::local_map::{Companions, LocalMap};
use crate::params::Params;
use crate::publish;
use geometry::Sim3;
use map::Keyframe;

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

impl Mapper {
    /// Takes in the map of `other`: its keyframes come behind its own, both see each other's points where the link says
    /// so, and all are optimised. `companions` are of the last of its own keyframes.
    pub fn absorb(
        mut self: Box<Self>,
        mut other: Box<Self>,
        link: &Link,
        companions: &Companions,
        params: &Params,
    ) -> Absorbed {
        let count = self.local.keyframes.len();
        let mut local = self.local.clone();
        local.append(other.local.clone(), &link.own_from_other);
        let Ok(mut moved) = closing::join_places(&mut local, count + link.other, link.own, params) else {
            return Absorbed::Two([self, other]);
        };
        self.local = local;
        // The last of its own keyframes have all the neighbours that they will have.
        let mut settled = self.take_up_depths();
        let behind = self.local.keyframes.len() - count;
        self.settler.begin(&self.local, companions, behind, &params.depth);
        settled.extend(self.take_up_depths());
        let of_other = other.take_up_depths();
        for index in count..self.local.keyframes.len() {
            let keyframe = publish::keyframe(&self.local, index);
            let kept = other.known.keyframes.get(&LocalMap::id(index - count));
            let semi_dense = kept.map_or_else(Default::default, |kept| kept.semi_dense.clone());
            self.known.keyframes.insert(keyframe.id, Keyframe { semi_dense, ..keyframe });
            self.places.add(LocalMap::id(index), self.local.keyframes[index].pyramid.base());
        }
        settled.extend(of_other.into_iter().map(|keyframe| count + keyframe));
        self.settler.take_in(other.settler, count);
        self.closer.take_in(other.closer, count);
        // The others came in as they are.
        moved.retain(|&keyframe| keyframe < count);
        self.note_moved(&moved);
        let update = self.update(moved, settled, None);
        Absorbed::One(self, Box::new(update))
    }
}
