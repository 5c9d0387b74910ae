use super::*;
use crate::test_support::{Numbers, random_map, sample_map, united};
use crate::{EdgeKind, KeyframeName, Observation, Sensor};
use geometry::{Pinhole, Sim3};
use nalgebra::SVector;
use proptest::prelude::*;

/// Agents' maps, all different, named by few names; some empty, some with references to keyframes that are
/// gone.
fn own_maps() -> impl Strategy<Value = Vec<Map>> {
    let one = (0u32..4, 0usize..3, 4usize..7, any::<bool>());
    prop::collection::vec(one, 1..6).prop_map(|maps| {
        maps.into_iter()
            .zip(100..)
            .map(|((keyframes, name, width, gone), seed)| {
                let camera = Pinhole { width, height: 5, fx: 4.0, fy: 4.5, cx: 2.5, cy: 2.0 };
                let info = AgentInfo::new(["a", "b", "a-2"][name], camera);
                let mut map = random_map(info, keyframes, seed);
                if gone && let Some((id, _)) = map.keyframes.pop_first() {
                    assert!(map.frames.iter().any(|frame| frame.reference == id));
                }
                map
            })
            .collect()
    })
}

/// Moves every keyframe and joins agents by edges and observations, as a merge does.
fn merge(map: &mut Map, numbers: &mut Numbers) {
    for keyframe in map.keyframes.values_mut() {
        let motion = Sim3::exp(&SVector::<f64, 7>::from_fn(|_, _| numbers.next() - 0.5));
        keyframe.world_from_keyframe = motion * keyframe.world_from_keyframe;
    }
    let ids: Vec<_> = map.keyframes.values().map(|keyframe| (keyframe.id, keyframe.agent)).collect();
    let Some(edge) = sample_map(2).edges.pop() else { return };
    for pair in ids.windows(2).filter(|pair| pair[0].1 != pair[1].1) {
        let (from, to) = (pair[0].0, pair[1].0);
        map.edges.insert(0, Edge { from, to, kind: EdgeKind::Merge, ..edge.clone() });
        let point = map.keyframes.get_mut(&from).and_then(|keyframe| keyframe.points.first_mut());
        let seen = Observation { keyframe: to, pixel: [1.0, 2.0], information: [1.0, 0.0, 1.0] };
        point.into_iter().for_each(|point| point.observations.insert(0, seen));
    }
}

proptest! {
    #[test]
    fn splitting_undoes_uniting(maps in own_maps(), parts in 1usize..4, seed in 1u64..1000) {
        let numbers = &mut Numbers::new(seed);
        let mut one = Map::unite(maps.clone()).unwrap();
        check::map(&one).unwrap();
        merge(&mut one, numbers);
        check::map(&one).unwrap();
        prop_assert_eq!(&one.split(), &maps);
        // United in parts, that are united then: all the same but for the names.
        let parts: Vec<Map> = maps
            .chunks(parts)
            .map(|part| {
                let mut part = Map::unite(part.to_vec()).unwrap();
                merge(&mut part, numbers);
                part
            })
            .collect();
        let nested = Map::unite(parts).unwrap();
        check::map(&nested).unwrap();
        prop_assert_eq!(nested.split(), maps);
    }
}

#[test]
fn what_is_united_stays_as_it_was() {
    let map = united();
    let names: Vec<&str> = map.agents.values().map(|info| info.name.as_str()).collect();
    assert_eq!(names, ["sample", "sample-2", "other"]);
    let (own, own_map) = (sample_map(3), &map.split()[0]);
    assert_eq!(*own_map, own);
    assert_eq!(map.trajectory_of(AgentId(0)), own.trajectory());
    assert_eq!(map.trajectory_of(AgentId(2)).len(), 5);
    assert_eq!(map.trajectory().len(), 30);
    let widths: Vec<usize> = map.keyframes.values().map(|keyframe| map.camera(keyframe).width).collect();
    assert_eq!(widths, [24, 24, 24, 24, 24, 30]);
}

#[test]
fn an_own_map_is_its_own_only_part() {
    assert_eq!(sample_map(2).split(), [sample_map(2)]);
}

/// Asserts that the maps are not united, for a reason that holds `words`.
#[track_caller]
fn assert_refused(maps: Vec<Map>, words: &str) {
    let error = Map::unite(maps).unwrap_err().to_string();
    assert!(error.contains(words), "{error}");
}

#[test]
fn the_same_map_twice_is_refused() {
    let other = united().split().remove(1);
    assert_refused(vec![sample_map(3), other.clone(), sample_map(3)], "the maps number 1 and 3");
    // Neither another name nor other poses and depths nor later keyframes make it another agent.
    let mut later = sample_map(3);
    later.agents.values_mut().for_each(|info| info.name = "again".into());
    later.keyframes.values_mut().for_each(|keyframe| keyframe.world_from_keyframe.scale *= 2.0);
    later.keyframes.values_mut().for_each(|keyframe| keyframe.semi_dense = Default::default());
    assert_refused(vec![later.clone(), sample_map(2)], "the same map twice");
    assert_refused(vec![united(), later.clone()], "\"sample\", \"again\"");
    // Equal images at other times, or other images at equal times, are another agent's.
    later.agents.values_mut().for_each(|info| info.identity = None);
    let mut shifted = later.clone();
    shifted.keyframes.values_mut().for_each(|keyframe| keyframe.timestamp += 1.0);
    assert!(Map::unite(vec![later, shifted]).is_ok());
    assert!(Map::unite(vec![sample_map(3), other]).is_ok());
}

#[test]
fn one_identity_is_one_run_whatever_it_holds() {
    let camera = sample_map(0).agents[&AgentId(0)].sensor;
    let identity = Some(Identity::random([5; 16]));
    let of = |name: &str, identity, seed| {
        let mut map = random_map(AgentInfo::new(name, camera), 2, seed);
        map.agents.values_mut().for_each(|info| info.identity = identity);
        map
    };
    assert_refused(vec![of("a", identity, 1), of("b", identity, 2)], "the same run");
    let later = identity.map(|identity| identity.later(1));
    let united = Map::unite(vec![of("a", identity, 1), of("a", later, 2), of("c", None, 3)]).unwrap();
    assert_refused(vec![of("d", later, 4), united.clone()], "\"d\", \"a-2\"");
    let own: Vec<_> = united.split().iter().map(|own| own.agents[&AgentId(0)].identity).collect();
    assert_eq!(own, [identity, later, None]);
}

#[test]
fn a_keyframe_keeps_its_name_in_every_map() {
    let own = random_map(AgentInfo::new("own", sample_map(0).agents[&AgentId(0)].sensor), 3, 21);
    let other = Map::unite(vec![sample_map(2), own.clone()]).unwrap();
    let whole =
        Map::unite(vec![random_map(AgentInfo::new("x", own.agents[&AgentId(0)].sensor), 4, 22), other])
            .unwrap();
    for (id, keyframe) in &own.keyframes {
        let name = own.name_of(*id).unwrap();
        assert_eq!((name.number, Some(name.agent)), (id.0, own.agents[&AgentId(0)].identity));
        let found = &whole.keyframes[&whole.find(name).unwrap()];
        assert_eq!((&found.image, whole.name_of(found.id)), (&keyframe.image, Some(name)));
        let missing = KeyframeName { number: name.number + 1, ..name };
        assert_eq!((whole.find(missing), sample_map(2).find(name)), (None, None));
    }
    assert_eq!(Map::new(*own.agents[&AgentId(0)].camera().unwrap()).name_of(KeyframeId(0)), None);
}

#[test]
fn what_cannot_be_united_is_refused() {
    assert_refused(Vec::new(), "no map");
    let mut orphan = sample_map(1);
    orphan.keyframes.values_mut().for_each(|keyframe| keyframe.agent = AgentId(3));
    assert_refused(vec![orphan], "agent 3 is not in the map");
    let mut high = sample_map(1);
    high.frames[0].reference = KeyframeId(u32::MAX);
    assert_refused(vec![high], "too many keyframes");
    let mut high = sample_map(1);
    high.frames[0].reference = KeyframeId(u32::MAX - 1);
    let one = Map::unite(vec![high.clone()]).unwrap();
    assert_eq!(one.split(), [high]);
    assert_refused(vec![one, united().split().remove(1)], "too many keyframes");
}

#[test]
fn contradictions_among_agents_are_found() {
    type Spoil = fn(&mut Map);
    fn agent(map: &mut Map, id: u16) -> &mut AgentInfo {
        map.agents.get_mut(&AgentId(id)).unwrap()
    }
    fn camera(map: &mut Map, id: u16) -> &mut geometry::Pinhole {
        match &mut agent(map, id).sensor {
            Sensor::Camera(camera) => camera,
            Sensor::Lidar => unreachable!("the sample has cameras"),
        }
    }
    fn own(map: &mut Map, id: u16) -> &mut OwnMap {
        agent(map, id).own.as_mut().unwrap()
    }
    let spoil: [(Spoil, &str); 11] = [
        (|map| agent(map, 1).identity = agent(map, 0).identity, "\"sample-2\" is another one's"),
        (|map| agent(map, 1).name = "sample".into(), "two agents have the name \"sample\""),
        (|map| agent(map, 1).name.clear(), "no name"),
        (|map| agent(map, 2).own = None, "\"other\" does not know its own map"),
        (|map| camera(map, 2).fx = -1.0, "no pinhole camera"),
        (|map| camera(map, 2).width = 24, "its image has 30×20 pixels"),
        (|map| own(map, 1).first_keyframe += 5, "is not one of agent 1"),
        (|map| own(map, 1).world_from_keyframe.clear(), "no pose in the agent's own map"),
        (|map| drop(map.keyframes.pop_last()), "which is missing"),
        (|map| own(map, 0).world_from_keyframe.values_mut().for_each(|p| p.scale = -1.0), "scale -1"),
        (|map| map.edges.iter_mut().for_each(|edge| edge.kind = EdgeKind::Loop), "joins two agents"),
    ];
    for (spoil, words) in spoil {
        let mut map = united();
        spoil(&mut map);
        let error = check::map(&map).unwrap_err();
        assert!(error.contains(words), "{error}");
    }
}
