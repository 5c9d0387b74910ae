//! The maps of LiDAR agents, merged as they come: as `loopbox merge` would, and once all is there with its result bit by
//! bit. A keyframe's scan takes about as many bytes as a camera's features, so that all is fetched and nothing looked at in
//! part.

use super::agents::Inputs;
use super::common_listener::CommonListener;
use super::common_maps::{Failed, WRITE_INTERVAL};
use super::merge_results::reported_verdict;
use super::remembering::Content;
use crate::blobs::MemoryBlobs;
use crate::lidar::merging::verdicts::LidarVerdicts;
use crate::lidar::merging::{
    Input, LidarMergeParams, LidarMergeRecord, LidarMerging, decision, merge_knowing, place_of,
};
use crate::lidar::write_merged;
use crate::results::{COMMON_OF_LIDARS, Owner, Results};
use crate::verdicts::{MapDigest, Verdicts};
use anyhow::{Result, anyhow};
use fleet::merge_results::{MergeResults, PairVerdict, PlacedAgent, numbers};
use geometry::Se3;
use sources::Stop;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// Merges LiDAR maps and writes what comes of them into a folder of their own.
pub(super) struct ScanCollector {
    folder: PathBuf,
    force: bool,
    /// Nothing before maps met, unless the folder was there.
    results: Option<Results>,
    /// Verdicts on pairs of maps as they are.
    verdicts: Arc<MemoryBlobs>,
    found: MergeResults,
    written: Option<Instant>,
    /// Something came that is not merged yet, or is not written.
    is_new: bool,
    to_write: bool,
}

impl ScanCollector {
    /// One that writes into a folder within `out`, which it makes once maps have met.
    ///
    /// # Errors
    /// When the folder is there and cannot be written to, or holds results of something else.
    pub fn new(out: &Path, force: bool) -> Result<Self> {
        let folder = out.join(COMMON_OF_LIDARS);
        let results = folder.is_dir().then(|| Results::create(&folder, &Owner::Merge, force)).transpose()?;
        let (verdicts, found, written) = Default::default();
        Ok(Self { folder, force, results, verdicts, found, written, is_new: false, to_write: false })
    }

    /// Something came.
    pub fn came(&mut self) {
        (self.is_new, self.to_write) = (true, true);
    }

    /// Whether something is to be merged.
    pub fn has_new(&self) -> bool {
        self.is_new
    }

    /// Whether all is merged and written.
    pub fn is_done(&self) -> bool {
        !self.is_new && !self.to_write
    }

    /// What was found by the maps as they were merged last.
    pub fn found(&self) -> &MergeResults {
        &self.found
    }

    /// Has what is not written merged and written next, whenever that was done last.
    pub fn request_write(&mut self) {
        (self.is_new, self.written) = (self.to_write, None);
    }

    /// Merges the maps, but for pairs as they were merged before, and writes them where it is time: when they are
    /// `at_rest`, and every now and then before. `listeners` hear of it.
    ///
    /// # Errors
    /// When the maps cannot be merged or results not be written.
    pub fn merge(
        &mut self,
        lent: &Inputs<Input>,
        at_rest: bool,
        listeners: &mut [Box<dyn CommonListener>],
        stop: &Stop,
    ) -> Result<(), Failed> {
        self.is_new = false;
        let Inputs { inputs, contents, .. } = lent;
        if inputs.len() < 2 {
            (self.found, self.to_write) = (found(lent, None), false);
            return Ok(());
        }
        let go_on = || if stop.requested() { Err(anyhow!("interrupted")) } else { Ok(()) };
        let params = LidarMergeParams::default();
        let verdicts = self.verdicts_on(contents, &params);
        let merging = merge_knowing(inputs, &params, (&[], Some(&verdicts)), &mut |_| go_on());
        let merging = merging.map_err(Failed::Merge)?;
        // A map that changed is never again as it was.
        let current = verdicts.objects();
        self.verdicts.retain(|name| current.contains(name));
        self.found = found(lent, Some(&merging));
        listeners.iter_mut().for_each(|listener| listener.lidars(&merging));
        let is_due = at_rest || self.written.is_none_or(|written| written.elapsed() > WRITE_INTERVAL);
        if merging.any_joined() && is_due {
            self.write(inputs, &merging).map_err(Failed::Write)?;
            self.written = Some(Instant::now());
        }
        self.to_write = merging.any_joined() && !is_due;
        Ok(())
    }

    /// The verdicts on these maps as they are.
    fn verdicts_on<'a>(&self, contents: &[Content], params: &'a LidarMergeParams) -> LidarVerdicts<'a> {
        let maps = contents.iter().map(|content| MapDigest::of_content(&content.hash)).collect();
        LidarVerdicts::among(Verdicts::among(self.verdicts.clone()), maps, params)
    }

    fn write(&mut self, inputs: &[Input], merging: &LidarMerging) -> Result<()> {
        let results = match &mut self.results {
            Some(results) => results,
            none => none.insert(Results::create(&self.folder, &Owner::Merge, self.force)?),
        };
        results.start_over()?;
        let mut record = LidarMergeRecord::of(inputs, merging);
        write_merged(results, inputs, merging, None, &mut record)?;
        results.commit()
    }
}

/// What a merging of LiDAR maps found; `None` of one map alone.
fn found(lent: &Inputs<Input>, merging: Option<&LidarMerging>) -> MergeResults {
    let identity = |input: usize| lent.contents[input].agent.to_string();
    let root = |input: usize| {
        let groups = merging.map_or(&[][..], |merging| &merging.groups);
        let group = groups.iter().find(|group| group.members.contains(&input));
        group.and_then(|group| group.members.first()).copied().unwrap_or(input)
    };
    let agent = |(number, input): (usize, &Input)| {
        let place = merging.map_or_else(Se3::identity, |merging| place_of(merging, number));
        PlacedAgent {
            agent: identity(number),
            name: input.name.clone(),
            keyframes: input.keyframe_count(),
            whole: lent.whole[number],
            root: identity(root(number)),
            root_from_agent: numbers(&place.into()),
        }
    };
    let pair_verdicts = merging.into_iter().flat_map(|merging| &merging.pairs).map(|pair| PairVerdict {
        names: [pair.a, pair.b].map(|input| lent.inputs[input].name.clone()),
        agents: [pair.a, pair.b].map(identity),
        verdict: reported_verdict(decision(pair), ![pair.a, pair.b].iter().all(|input| lent.over[*input])),
        why: (decision(pair) != "accepted").then(|| pair.reason()),
        pending: false,
    });
    MergeResults {
        agents: lent.inputs.iter().enumerate().map(agent).collect(),
        pair_verdicts: pair_verdicts.collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::blobs::Blobs;
    use crate::lidar::{LidarMergeOptions, merge_maps};
    use fleet::hash::ObjectHash;
    use geometry::{GrayImage, Sim3};
    use loopbox_tests::lidar::{HALL, sweep};
    use map::{AgentInfo, Identity, Keyframe, KeyframeId, Map, Scan, Sensor, Uuid};
    use nalgebra::Vector3;
    use std::fs;
    use std::sync::Mutex;

    fn agent(name: &str) -> Identity {
        Identity { uuid: Uuid::from_u128(name.as_bytes()[0].into()), epoch: 0 }
    }

    fn keyframe(number: u32, world_from_keyframe: Sim3, points: &[[f32; 3]]) -> Keyframe {
        let image = Arc::new(GrayImage::filled(0, 0, 0));
        let scan = Some(Arc::new(Scan::new(points.iter().copied())));
        let time = f64::from(number);
        Keyframe { scan, ..Keyframe::of_image(KeyframeId(number), time, 0, world_from_keyframe, image) }
    }

    /// The map of a LiDAR with these keyframes.
    fn map(name: &str, keyframes: impl Iterator<Item = Keyframe>) -> Map {
        let identity = Some(agent(name));
        let mut map = Map::of(AgentInfo { identity, ..AgentInfo::new(name, Sensor::Lidar) });
        map.keyframes = keyframes.map(|keyframe| (keyframe.id, keyframe)).collect();
        map
    }

    /// A keyframe a metre along a lane of the hall, in the frame of the first.
    fn along(name: &str, from: f64, count: u32) -> Map {
        let at = |x: f64, y: f64| Se3::new(Default::default(), Vector3::new(x, y, 0.0));
        let seen = |k: u32| {
            let points: Vec<_> = sweep(&HALL, |_| at(from + f64::from(k), 5.0), f64::from(k))
                .iter()
                .map(|r| r.point)
                .collect();
            keyframe(k, at(f64::from(k), 0.0).into(), &points)
        };
        map(name, (0..count).map(seen))
    }

    /// Maps with what stands for their content, in a folder of agents' maps.
    fn lent(folder: &Path, maps: &[(&Map, u8)]) -> Inputs<Input> {
        let name = |map: &Map| map.agents[&Default::default()].name.clone();
        let input = |(map, _): &(&Map, u8)| {
            let path = folder.join(format!("{}.mcap", name(map)));
            map::save_map(&path, map).unwrap();
            Input::of(path, (*map).clone()).unwrap()
        };
        let content = |(map, version): &(&Map, u8)| {
            let hash = ObjectHash::of(&[*version]);
            Content { agent: agent(&name(map)), hash }
        };
        let (inputs, contents) = (maps.iter().map(input).collect(), maps.iter().map(content).collect());
        let all = vec![true; maps.len()];
        Inputs { inputs, contents, whole: all.clone(), over: all, files: Vec::new() }
    }

    /// Keeps the topics of what is published to ROS 2.
    #[derive(Clone, Default)]
    struct Topics(Arc<Mutex<Vec<(String, usize)>>>);

    impl ros2::Outlet for Topics {
        fn publish(&mut self, topic: &str, message: Vec<u8>) {
            self.0.lock().unwrap().push((topic.to_owned(), message.len()));
        }
    }

    #[test]
    fn a_common_map_of_lidars_reaches_listeners_and_is_published() {
        let room = tempfile::tempdir().unwrap();
        let (a, b) = (along("a", -12.0, 9), along("b", -8.0, 9));
        let mut collector = ScanCollector::new(room.path(), false).unwrap();
        let topics = Topics::default();
        let mut listeners: Vec<Box<dyn CommonListener>> =
            vec![Box::new(crate::ros::Common::new(topics.clone()))];
        let both = lent(room.path(), &[(&a, 0), (&b, 0)]);
        assert!(collector.merge(&both, true, &mut listeners, &Stop::default()).is_ok());
        let messages = topics.0.lock().unwrap().clone();
        let names: Vec<&str> = messages.iter().map(|(topic, _)| &**topic).collect();
        // Nobody has said where they are since: these maps have no frames.
        assert_eq!(names, ["/a/common_points", "/tf_static"]);
        // Three floats a point, of at most 65536.
        let points: usize = both.inputs.iter().map(|i| i.map.cloud(1.0).count()).sum();
        let cloud = messages[0].1;
        assert!(cloud > 12 * points.min(1 << 16) / 2 && cloud < 13 * (1 << 16), "{cloud} {points}");
    }

    fn merged(collector: &mut ScanCollector, lent: &Inputs<Input>, at_rest: bool) {
        assert!(collector.merge(lent, at_rest, &mut [], &Stop::default()).is_ok());
    }

    #[test]
    fn maps_are_merged_as_their_files_and_written_when_it_is_time() {
        let room = tempfile::tempdir().unwrap();
        let (a, b) = (along("a", -12.0, 9), along("b", -8.0, 9));
        let file = room.path().join("lidar/map.mcap");
        let mut collector = ScanCollector::new(room.path(), false).unwrap();
        collector.came();
        assert!(collector.has_new() && !collector.is_done());
        merged(&mut collector, &lent(room.path(), &[(&a, 0)]), true);
        assert_eq!((collector.found().agents.len(), collector.found().pair_verdicts.len()), (1, 0));
        assert!(collector.is_done() && !file.parent().unwrap().exists(), "one alone has no common map");
        collector.came();
        merged(&mut collector, &lent(room.path(), &[(&a, 0), (&b, 0)]), false);
        let found = collector.found().clone();
        assert_eq!((found.accepted(), &found.agents[1].root), (1, &agent("a").to_string()), "{found:?}");
        let [x, y, .., scale] = found.agents[1].root_from_agent;
        assert!((x - 4.0).abs() < 0.05 && y.abs() < 0.05 && scale == 1.0, "{found:?}");
        assert!(collector.is_done(), "what met first is written at once");
        // The other map grew: that is written when it is time.
        let before = fs::read(&file).unwrap();
        let grown = lent(room.path(), &[(&a, 0), (&along("b", -8.0, 10), 1)]);
        collector.came();
        merged(&mut collector, &grown, false);
        assert!(!collector.is_done() && fs::read(&file).unwrap() == before);
        collector.request_write();
        assert!(collector.has_new());
        merged(&mut collector, &grown, true);
        assert!(collector.is_done());
        let (paths, out) =
            (["a.mcap", "b.mcap"].map(|name| room.path().join(name)), room.path().join("files"));
        merge_maps(&paths, &LidarMergeOptions::to(&out), &Stop::default(), &mut |_| {}).unwrap();
        for name in ["map.mcap", "cloud.ply", "trajectory-b.txt"] {
            let same =
                fs::read(out.join(name)).unwrap() == fs::read(room.path().join("lidar").join(name)).unwrap();
            assert!(same, "{name}");
        }
        // Started again, it goes on there; over results of something else it does not begin.
        drop(collector);
        assert!(ScanCollector::new(room.path(), false).is_ok());
        fs::rename(out.join("merge.json"), room.path().join("lidar/unmerge.json")).unwrap();
        fs::remove_file(room.path().join("lidar/merge.json")).unwrap();
        let refused = ScanCollector::new(room.path(), false).err().unwrap();
        assert!(refused.to_string().contains("a merge that was taken apart"), "{refused}");
    }

    #[test]
    fn what_pairs_made_of_each_other_is_asked_once_for_maps_as_they_are() {
        let room = tempfile::tempdir().unwrap();
        let (a, b) = (along("a", -12.0, 6), along("b", -9.0, 6));
        let mut collector = ScanCollector::new(room.path(), false).unwrap();
        let both = lent(room.path(), &[(&a, 0), (&b, 0)]);
        merged(&mut collector, &both, false);
        assert_eq!(collector.found().accepted(), 1);
        // Were they compared again, they would meet again.
        let nothing = slam_lidar::merging::robot_map::RobotMap::new(&[]);
        let refused = slam_lidar::merging::merge(&nothing, &nothing);
        collector.verdicts.retain(|_| false);
        let params = LidarMergeParams::default();
        collector.verdicts_on(&both.contents, &params).put([0, 1], &refused).unwrap();
        merged(&mut collector, &both, false);
        assert_eq!(collector.found().accepted(), 0);
        merged(&mut collector, &lent(room.path(), &[(&a, 0), (&b, 1)]), false);
        assert_eq!(collector.found().accepted(), 1);
        assert_eq!(collector.verdicts.list("").unwrap().len(), 1, "those on maps as they were stay");
    }

    /// Numbers as a hostile agent may tell them: what passes the checks of a map.
    #[test]
    fn maps_that_make_no_sense_are_not_merged_and_break_nothing() {
        let room = tempfile::tempdir().unwrap();
        let far = |x: f64| Sim3::from(Se3::new(Default::default(), Vector3::new(x, -x, x)));
        let a = along("a", -12.0, 3);
        let wide = [[4000.0, -4000.0, 4000.0], [-4000.0, 4000.0, 0.0], [1e-3, 0.0, 0.0]];
        let odd = [
            map("e", (0..3).map(|k| keyframe(k, Sim3::identity(), &[]))),
            map("f", (0..3).map(|k| keyframe(k, far(9e3 * f64::from(k)), &[[1.0, 2.0, 3.0]]))),
            map("g", (0..9).map(|k| keyframe(k, far(5e3 * f64::from(k)), &wide))),
            map("h", std::iter::once(keyframe(7, far(-5e4), &wide))),
        ];
        for x in [1e300, 1e12, -6e4] {
            let beyond = map("i", std::iter::once(keyframe(7, far(x), &wide)));
            let refused = Input::of("i.mcap".into(), beyond).err().unwrap().to_string();
            assert!(refused.contains("i.mcap: keyframe 7 lies") && refused.contains("100000 m"), "{refused}");
        }
        let maps: Vec<_> = std::iter::once(&a).chain(&odd).map(|map| (map, 0)).collect();
        maps.iter().for_each(|(map, _)| assert_eq!(map.check(), Ok(())));
        let mut collector = ScanCollector::new(room.path(), false).unwrap();
        merged(&mut collector, &lent(room.path(), &maps), true);
        let found = collector.found();
        assert_eq!(
            (found.agents.len(), found.pair_verdicts.len(), found.accepted()),
            (5, 10, 0),
            "{found:?}"
        );
        assert!(!room.path().join("lidar").exists());
    }
}
