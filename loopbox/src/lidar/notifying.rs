//! Whoever listens to a run is told how its map grows.

use crate::listeners::Listeners;
use map::{AgentId, AgentInfo, Identity, Map, MapDelta, Moved};

/// Tells listeners what is new of a map.
pub(super) struct Notifier {
    listeners: Listeners,
    /// Whose map it is.
    identity: Option<Identity>,
    keyframes: usize,
    sequence: u64,
}

impl Notifier {
    /// The run of this agent begins.
    pub fn begins(listeners: Listeners, about: &AgentInfo) -> Self {
        listeners.notify(|listener| listener.begins(about));
        Self { listeners, identity: None, keyframes: 0, sequence: 0 }
    }

    /// Tells the keyframes that are new since; all have moved where a loop was `closed`. Another fragment is another map.
    pub fn changed(&mut self, map: &Map, closed: bool) {
        let identity = map.agents.get(&AgentId::default()).and_then(|about| about.identity);
        let Some(identity) = identity.filter(|_| self.listeners.are_there()) else { return };
        if self.identity.replace(identity).is_some_and(|before| before != identity) {
            (self.keyframes, self.sequence) = (0, 0);
        }
        if map.keyframes.len() == self.keyframes && !closed {
            return;
        }
        let moved = |keyframe: &map::Keyframe| {
            let world_from_keyframe = keyframe.world_from_keyframe;
            Moved { keyframe: keyframe.id, world_from_keyframe }
        };
        let delta = MapDelta {
            sequence: self.sequence,
            added: map.keyframes.values().skip(self.keyframes).cloned().collect(),
            moved: map.keyframes.values().take(if closed { self.keyframes } else { 0 }).map(moved).collect(),
            edges: Some(map.edges.clone()),
            ..MapDelta::default()
        };
        (self.keyframes, self.sequence) = (map.keyframes.len(), self.sequence + 1);
        self.listeners.notify(|listener| listener.changed(identity, vec![delta.clone()]));
    }

    /// The run has ended with these maps.
    pub fn ended(&self, maps: &[Map]) {
        self.listeners.notify(|listener| listener.ended(maps));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::listeners::MapListener;
    use geometry::{GrayImage, Sim3};
    use map::{Keyframe, KeyframeId, Scan, Sensor};
    use std::sync::{Arc, Mutex};

    /// The map as it was told.
    struct Replica(Arc<Mutex<Option<Map>>>);

    impl MapListener for Replica {
        fn begins(&mut self, about: &AgentInfo) {
            *self.0.lock().unwrap() = Some(Map::of(about.clone()));
        }

        fn changed(&mut self, _: Identity, deltas: Vec<MapDelta>) {
            let mut known = self.0.lock().unwrap();
            deltas.into_iter().for_each(|delta| known.as_mut().unwrap().take_in(delta));
        }

        fn ended(&mut self, maps: &[Map]) {
            assert_eq!(maps[0].keyframes, self.0.lock().unwrap().as_ref().unwrap().keyframes);
        }
    }

    #[test]
    fn listeners_get_a_map_keyframe_by_keyframe_and_its_corrections() {
        let about =
            AgentInfo { identity: Some(Identity::of_scans(0.0, &[])), ..AgentInfo::new("a", Sensor::Lidar) };
        let (mut map, replica) = (Map::of(about.clone()), Arc::new(Mutex::new(None)));
        let mut listeners = Listeners::default();
        listeners.add(Replica(Arc::clone(&replica)));
        let mut notifier = Notifier::begins(listeners, &about);
        for number in 0..4u32 {
            let (id, none) = (KeyframeId(number), Arc::new(GrayImage::filled(0, 0, 0)));
            let mut keyframe = Keyframe::of_image(id, number.into(), 0, Sim3::identity(), none);
            keyframe.scan = Some(Arc::new(Scan::new([[1.0, number as f32, 0.0]])));
            map.keyframes.insert(id, keyframe);
            let closed = number == 2;
            if closed {
                map.keyframes.values_mut().for_each(|k| k.world_from_keyframe.translation.x += 1.0);
            }
            notifier.changed(&map, closed);
            notifier.changed(&map, false);
            assert!(replica.lock().unwrap().as_ref() == Some(&map), "after keyframe {number}");
        }
        notifier.ended(std::slice::from_ref(&map));
    }
}
