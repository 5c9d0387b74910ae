//! The page of one who collects the maps of many: who is near, and the common map as it grows.

use super::chunk::Chunk;
use super::feed::loops_of;
use super::scene::{Agent, Placed, Scene, Step};
use super::status::Status;
use super::web::{Address, Server};
use super::{Neighbourhood, Shared};
use crate::process;
use anyhow::Result;
use geometry::GrayImage;
use map::{AgentId, Identity, Keyframe, KeyframeId, Map, MapError, SemiDense};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// A page that shows what somebody collects; it is served until the program ends.
pub struct StationWatch {
    shared: Arc<Shared>,
    server: Server,
}

impl StationWatch {
    /// Begins to serve it, before anything is there to be shown; `folder` is where results go.
    ///
    /// # Errors
    /// When the address cannot be listened at.
    pub fn start(address: Address, title: &str, folder: &Path) -> Result<Self> {
        let shared = Arc::new(Shared::new(Scene::default(), None));
        let folder = folder.display().to_string();
        shared.scene().set_status(Status { state: "collecting", folder, ..Status::default() });
        let server = Server::of_station(&shared, address, title)?;
        Ok(Self { shared, server })
    }

    /// Where to open it.
    pub fn url(&self) -> &str {
        self.server.url()
    }

    /// Shows who is near and what became of meeting them, from any thread.
    pub fn neighbourhood(&self) -> impl Fn(Neighbourhood) + Send + Sync + 'static + use<> {
        let shared = Arc::clone(&self.shared);
        move |mut near| {
            // It has no map of its own of which others could lack anything.
            near.links.iter_mut().for_each(|link| link.lacks = None);
            shared.change_status(|status| {
                status.neighbourhood = Some(near);
                status.memory_bytes = process::memory_bytes();
            });
        }
    }

    /// Shows the common map, from any thread.
    pub fn map(&self) -> CommonMap {
        CommonMap {
            shared: Arc::clone(&self.shared),
            root: None,
            agents: Vec::new(),
            keyframes: BTreeMap::new(),
        }
    }

    /// Lets viewers have the last of it.
    pub fn end(self, note: &str) {
        self.shared.change_status(|status| (status.state, status.note) = ("done", note.to_owned()));
        self.shared.over.store(true, Ordering::Release);
        self.server.wait_for_clients();
    }
}

/// What a keyframe is called in all versions of a common map: its agent, and its number in the agent's own map.
type Name = (Identity, u32);

/// Shows versions of a common map, one after the other: of each what the one before had not.
pub struct CommonMap {
    shared: Arc<Shared>,
    /// The agent in whose world all is.
    root: Option<Identity>,
    /// Agents in the order in which they came.
    agents: Vec<Identity>,
    keyframes: BTreeMap<Name, Displayed>,
}

/// A keyframe that is shown.
struct Displayed {
    /// What viewers call it.
    id: u32,
    /// What its points were made of.
    made_of: Option<(Arc<GrayImage>, map::Shared<SemiDense>)>,
}

impl CommonMap {
    /// Shows a map of cameras in place of the one before, without agents that have no identity.
    ///
    /// # Errors
    /// When an agent has no camera.
    pub fn show(&mut self, map: &Map) -> Result<(), MapError> {
        map.of_cameras()?;
        let names: BTreeMap<KeyframeId, Name> =
            map.keyframes.values().filter_map(|keyframe| Some((keyframe.id, name(map, keyframe)?))).collect();
        let there: BTreeSet<&Name> = names.values().collect();
        let root = map.agents.values().next().and_then(|about| about.identity);
        // In another world, or with keyframes gone, it is another map.
        let is_other = root != self.root || self.keyframes.keys().any(|name| !there.contains(name));
        if is_other {
            (self.root, self.agents, self.keyframes) = (root, Vec::new(), BTreeMap::new());
        }
        let places = self.places(map);
        for name in names.values() {
            let id = self.keyframes.len() as u32;
            self.keyframes.entry(*name).or_insert(Displayed { id, made_of: None });
        }
        let id = |keyframe: &KeyframeId| Some(self.keyframes.get(names.get(keyframe)?)?.id);
        let placed = map.keyframes.values().filter_map(|keyframe| {
            let (agent, frame_index) = (places.get(&keyframe.agent).copied()?, keyframe.frame_index);
            let world_from_keyframe = keyframe.world_from_keyframe;
            Some(Placed { id: id(&keyframe.id)?, agent, frame_index, world_from_keyframe })
        });
        let placed: Vec<Placed> = placed.collect();
        let edges = loops_of(&map.edges);
        let edges = edges
            .into_iter()
            .filter_map(|[from, to, kind]| Some([id(&KeyframeId(from))?, id(&KeyframeId(to))?, kind]));
        let edges: Vec<[u32; 3]> = edges.collect();
        let steps = steps(map, &places);
        let chunks = self.chunks(map, &names);
        let mut scene = self.shared.scene();
        if is_other {
            scene.clear();
        }
        scene.set_agents(self.agents_of(map));
        scene.place(placed);
        chunks.into_iter().for_each(|(id, chunk)| scene.set_chunk(id, chunk));
        scene.set_trajectory(0, steps);
        scene.set_edges(edges);
        let (keyframes, points) = (scene.keyframes().count(), scene.points());
        let status = Status { keyframes, points, ..scene.status().clone() };
        scene.set_status(status);
        Ok(())
    }

    /// The place of each agent among those shown; who is new comes last.
    fn places(&mut self, map: &Map) -> BTreeMap<AgentId, u16> {
        let mut places = BTreeMap::new();
        for (agent, about) in &map.agents {
            let Some(identity) = about.identity else { continue };
            let known = self.agents.iter().position(|known| *known == identity);
            let place = known.unwrap_or(self.agents.len());
            if place == self.agents.len() {
                self.agents.push(identity);
            }
            places.insert(*agent, place as u16);
        }
        places
    }

    /// The agents shown, as the map has them.
    fn agents_of(&self, map: &Map) -> Vec<Agent> {
        let about = |identity: &Identity| {
            let about = map.agents.values().find(|about| about.identity == Some(*identity))?;
            Some(Agent { name: about.name.clone(), camera: *about.camera()?, metric: about.is_metric() })
        };
        self.agents.iter().filter_map(about).collect()
    }

    /// Points of keyframes whose images or depths are others than before.
    fn chunks(&mut self, map: &Map, names: &BTreeMap<KeyframeId, Name>) -> Vec<(u32, Chunk)> {
        let mut new = Vec::new();
        for keyframe in map.keyframes.values().filter(|keyframe| !keyframe.semi_dense.is_empty()) {
            let Some(displayed) = names.get(&keyframe.id).and_then(|name| self.keyframes.get_mut(name))
            else {
                continue;
            };
            let is_known = displayed.made_of.as_ref().is_some_and(|(image, depth)| {
                Arc::ptr_eq(image, &keyframe.image) && std::ptr::eq(&**depth, &*keyframe.semi_dense)
            });
            if !is_known {
                displayed.made_of = Some((Arc::clone(&keyframe.image), keyframe.semi_dense.clone()));
                new.push((displayed.id, keyframe));
            }
        }
        let chunk = |(id, k): (u32, &Keyframe)| {
            (id, Chunk::new(map.camera(k), &k.image, k.color.as_ref(), &k.semi_dense))
        };
        new.into_par_iter().map(chunk).collect()
    }
}

/// What a keyframe is called in all versions of a map.
fn name(map: &Map, keyframe: &Keyframe) -> Option<Name> {
    let about = map.agents.get(&keyframe.agent)?;
    let first = about.own.as_ref().map_or(0, |own| own.first_keyframe);
    Some((about.identity?, keyframe.id.0.checked_sub(first)?))
}

/// The trajectories, agent by agent.
pub(super) fn steps(map: &Map, places: &BTreeMap<AgentId, u16>) -> Vec<Step> {
    let step = |frame: &map::FramePose| {
        let agent = *places.get(&map.keyframes.get(&frame.reference)?.agent)?;
        Some(Step::new(frame, agent, &map.world_from_frame(frame)?))
    };
    let mut steps: Vec<Step> = map.frames.iter().filter_map(step).collect();
    steps.sort_by_key(|step| step.agent);
    steps
}

#[cfg(test)]
mod tests {
    use super::super::chunk::tests::{CAMERA, dense};
    use super::super::scene::{Cursor, SceneUpdate};
    use super::*;
    use geometry::Sim3;
    use map::{AgentInfo, Uuid};
    use nalgebra::Vector3;

    /// A map of an agent, whose keyframes have depth and stand at these places along x.
    fn own(name: &str, along: &[f64]) -> Map {
        let uuid = Uuid::from_u128(name.as_bytes()[0].into());
        let identity = Some(Identity { uuid, epoch: 0 });
        let mut map = Map::of(AgentInfo { identity, ..AgentInfo::new(name, CAMERA) });
        for (id, x) in (0..).zip(along) {
            let (image, depth) = dense();
            let pose = Sim3::new(Default::default(), Vector3::new(*x, 0.0, 0.0), 1.0);
            let image = Arc::new(image);
            // No two agents take images at the same times.
            let time = f64::from(id) + 1e3 * f64::from(name.as_bytes()[0]);
            let keyframe = Keyframe::of_image(KeyframeId(id), time, u64::from(id), pose, image);
            map.keyframes.insert(keyframe.id, Keyframe { semi_dense: depth.into(), ..keyframe });
        }
        map
    }

    /// A page, and what is new to who looks at it.
    struct Page {
        common: CommonMap,
        cursor: Cursor,
    }

    impl Page {
        fn new() -> Self {
            let shared = Arc::new(Shared::new(Scene::default(), None));
            let (root, agents, keyframes) = Default::default();
            Self { common: CommonMap { shared, root, agents, keyframes }, cursor: Cursor::default() }
        }

        fn shows(&mut self, map: &Map) -> SceneUpdate {
            self.common.show(map).expect("a map of cameras");
            self.common.shared.scene().update_since(&mut self.cursor, usize::MAX)
        }
    }

    /// Whose keyframes follow a reset.
    fn names(update: &SceneUpdate) -> Vec<String> {
        update.reset.iter().flatten().map(|agent| agent.name.clone()).collect()
    }

    fn placed(update: &SceneUpdate) -> Vec<(u32, u16, f64)> {
        update.keyframes.iter().map(|k| (k.id, k.agent, k.world_from_keyframe.translation.x)).collect()
    }

    #[test]
    fn of_a_version_that_grew_what_is_new_is_displayed() {
        let mut page = Page::new();
        let (mut a, b) = (own("a", &[0.0, 1.0]), own("b", &[5.0]));
        let first = page.shows(&Map::unite(vec![a.clone(), b.clone()]).expect("two agents"));
        assert_eq!(names(&first), ["a", "b"]);
        assert_eq!(placed(&first), [(0, 0, 0.0), (1, 0, 1.0), (2, 1, 5.0)]);
        assert_eq!(first.chunks.len(), 3);
        // The first agent goes on: in the united map the other's keyframes are called otherwise now.
        let mut longer = own("a", &[0.0, 1.0, 2.0]);
        longer.keyframes.extend(std::mem::take(&mut a.keyframes));
        let second = page.shows(&Map::unite(vec![longer.clone(), b.clone()]).expect("two agents"));
        assert_eq!((second.reset.is_none(), placed(&second)), (true, vec![(3, 0, 2.0)]));
        assert_eq!(second.chunks.len(), 1);
        // Another joins.
        let c = own("c", &[9.0]);
        let third = page.shows(&Map::unite(vec![longer, b, c]).expect("three agents"));
        assert_eq!(third.reset.as_ref().map(Vec::len), Some(3));
        assert_eq!((third.keyframes.len(), third.keyframes[4].agent), (5, 2));
        assert_eq!(page.common.shared.scene().status().keyframes, 5);
    }

    #[test]
    fn a_map_of_other_agents_replaces_the_displayed_one() {
        let mut page = Page::new();
        let (a, b) = (own("a", &[0.0, 1.0]), own("b", &[5.0]));
        page.shows(&Map::unite(vec![a.clone(), b.clone()]).expect("two agents"));
        // Their merge is taken back.
        let alone = page.shows(&a);
        assert_eq!(names(&alone), ["a"]);
        assert_eq!(placed(&alone), [(0, 0, 0.0), (1, 0, 1.0)]);
        let other = page.shows(&b);
        assert_eq!((placed(&other), names(&other)), (vec![(0, 0, 5.0)], vec!["b".to_owned()]));
        let mut nameless = own("d", &[0.0]);
        nameless.agents.values_mut().for_each(|about| about.identity = None);
        assert!(page.shows(&nameless).keyframes.is_empty(), "who has no identity cannot be told from others");
    }
}
