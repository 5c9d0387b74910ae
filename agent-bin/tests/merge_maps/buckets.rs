//! Maps and verdicts in a bucket: the feature `object-store`. `script/buckets` runs these.

#[cfg(not(feature = "object-store"))]
use crate::support::loopbox;
use crate::support::{Case, Runs, arg};

#[cfg(not(feature = "object-store"))]
#[test]
fn a_build_without_buckets_names_the_feature() {
    let (left, case) = (Runs::get().run("left"), Case::new());
    let refusal = ["this loopbox was built without buckets", "hint: ", "--features object-store"];
    let bucket = "s3://bucket/verdicts";
    loopbox(&["verdict", arg(&left), arg(&left), "--verdicts", bucket]).assert_refused(&refusal);
    loopbox(&["propose", "gs://bucket/maps/*"]).assert_refused(&refusal);
    loopbox(&["run", "s3://bucket/recordings/a", "--out", arg(&case.out())]).assert_refused(&refusal);
    loopbox(&["merge", arg(&left), "az://box/a", "--out", arg(&case.out())]).assert_refused(&refusal);
    assert!(!case.out().exists());
}

#[cfg(feature = "object-store")]
mod served {
    use super::{Case, Runs, arg};
    use crate::bucket::Server;
    use map::{KeyframeId, Map};
    use std::collections::BTreeMap;
    use std::fs;
    use std::path::Path;
    use std::process::{Child, Command, Output, Stdio};
    use std::time::{Duration, Instant};

    fn put_map(server: &Server, runs: &Runs, name: &str) {
        let map = fs::read(runs.run(name).join("map.mcap")).unwrap();
        server.put(&format!("maps/{name}/map.mcap"), &map);
    }

    fn command(server: &Server, case: &Case, args: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_loopbox"));
        server.serve(command.args(args), &case.path("cache"));
        command
    }

    fn run(server: &Server, case: &Case, args: &[&str]) -> Output {
        command(server, case, args).output().unwrap()
    }

    fn texts(output: &Output) -> [String; 2] {
        [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text).into_owned())
    }

    fn only_file(folder: &Path) -> Vec<u8> {
        let files: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
        assert_eq!(files.len(), 1, "{files:?}");
        fs::read(&files[0]).unwrap()
    }

    #[test]
    fn ten_processes_share_a_bucket_of_maps_and_verdicts_and_one_is_killed() {
        let Some(server) = Server::begin() else { return };
        let (runs, case) = (Runs::get(), Case::new());
        ["left", "right"].iter().for_each(|name| put_map(&server, runs, name));
        let [a, b] = ["s3://bucket/maps/left", "s3://bucket/maps/right/map.mcap"];
        let begin = |number: usize| {
            let (first, second) = if number.is_multiple_of(2) { (a, b) } else { (b, a) };
            let args = ["verdict", first, second, "--quiet", "--verdicts", "s3://bucket/verdicts/"];
            command(&server, &case, &args).stdout(Stdio::null()).spawn().expect("loopbox starts")
        };
        let mut killed = begin(0);
        let others: Vec<Child> = (1..10).map(begin).collect();
        // In the middle of reading maps, most of the time.
        std::thread::sleep(Duration::from_millis(300));
        killed.kill().unwrap();
        killed.wait().unwrap();
        for mut one in others {
            assert!(one.wait().unwrap().success());
        }
        let names = server.names("verdicts/");
        assert!(names.len() == 1 && names[0].ends_with(".verdict"), "{names:?}");
        let kept = server.get(&names[0]);

        // In a folder, by the runs' own files, it has the same name and is the same to the byte.
        let folder = case.path("folder");
        let uri = format!("file://{}", arg(&folder));
        let (left, right) = (runs.run("left"), runs.run("right"));
        let output = run(&server, &case, &["verdict", arg(&left), arg(&right), "--verdicts", &uri]);
        assert!(output.status.success(), "{:?}", texts(&output));
        assert!(only_file(&folder) == kept);
        assert!(folder.join(names[0].trim_start_matches("verdicts/")).is_file());

        // Who is killed leaves no half of a map in the cache.
        let copies = ["left", "right"]
            .map(|name| case.path("cache/loopbox/maps/s3/bucket/maps").join(name).join("map.mcap"));
        for (name, copies) in ["left", "right"].iter().zip(copies) {
            let versions: Vec<_> = fs::read_dir(copies).unwrap().map(|entry| entry.unwrap().path()).collect();
            assert_eq!(versions.len(), 1, "{versions:?}");
            assert!(
                fs::read(versions[0].join("map.mcap")).unwrap()
                    == fs::read(runs.run(name).join("map.mcap")).unwrap()
            );
        }
    }

    #[test]
    fn a_prefix_of_maps_is_proposed_and_merged_as_the_same_maps_of_this_machine() {
        let Some(server) = Server::begin() else { return };
        let (runs, case) = (Runs::get(), Case::new());
        ["left", "right", "elsewhere"].iter().for_each(|name| put_map(&server, runs, name));
        let proposed = run(&server, &case, &["propose", "s3://bucket/maps/*", "--json", "--quiet"]);
        let [proposed, said] = texts(&proposed);
        let pairs: serde_json::Value = serde_json::from_str(&proposed).expect(&said);
        let likeliest = &pairs[0]["maps"];
        assert_eq!(likeliest[0], "s3://bucket/maps/left/map.mcap", "{pairs}");
        assert_eq!(likeliest[1], "s3://bucket/maps/right/map.mcap", "{pairs}");

        let merge = |maps: &[&str], verdicts: &str, out: &Path| {
            let args = [&["merge"], maps, &["--verdicts", verdicts, "--out", arg(out)]].concat();
            let output = run(&server, &case, &args);
            assert!(output.status.success(), "{:?}", texts(&output));
            texts(&output)
        };
        let outs = ["bucket", "again", "here"].map(|name| case.path(name));
        let [first, _] = merge(&["s3://bucket/maps/*"], "s3://bucket/verdicts", &outs[0]);
        assert!(first.contains("left + right: accepted, travelling opposite ways"), "{first}");
        assert_eq!(server.names("verdicts/").len(), 3);
        // Verdicts that are in the bucket are not looked for again, whoever has the maps.
        let maps = ["elsewhere", "left", "right"].map(|name| runs.run(name));
        let maps = maps.each_ref().map(|path| arg(path));
        let [_, said] = merge(&maps, "s3://bucket/verdicts", &outs[1]);
        assert!(said.contains("making the common map") && !said.contains("looking where"), "{said}");
        merge(&maps, arg(&case.path("folder")), &outs[2]);
        assert!(fs::read(outs[1].join("map.mcap")).unwrap() == fs::read(outs[2].join("map.mcap")).unwrap());
        let clouds = [&outs[0], &outs[2]].map(|out| fs::read(out.join("cloud.ply")).unwrap());
        assert!(clouds[0] == clouds[1], "the maps of the bucket make another cloud");
    }

    #[test]
    fn a_recording_in_the_bucket_is_mapped_as_that_of_this_machine() {
        let Some(server) = Server::begin() else { return };
        let (runs, case) = (Runs::get(), Case::new());
        let recording = runs.truth("left").parent().unwrap().to_owned();
        for folder in [recording.clone(), recording.join("images")] {
            for path in fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()) {
                let Ok(bytes) = fs::read(&path) else { continue };
                let name = path.strip_prefix(&recording).unwrap().to_str().unwrap();
                server.put(&format!("recordings/left/{name}"), &bytes);
            }
        }
        let map = |recording: &str, out: &str| {
            let out = case.path(out);
            let output = run(&server, &case, &["run", recording, "--end", "2", "--out", arg(&out)]);
            let [_, said] = texts(&output);
            assert!(output.status.success(), "{said}");
            (fs::read(out.join("trajectory.txt")).unwrap(), said)
        };
        let (here, _) = map(arg(&recording), "here");
        let (there, said) = map("s3://bucket/recordings/left", "there");
        assert!(here == there && said.contains("copying s3://bucket/recordings/left, "), "{said}");
        let (again, said) = map("s3://bucket/recordings/left/", "again");
        assert!(here == again && !said.contains("copying"), "{said}");
        let told = |place: &str| texts(&run(&server, &case, &["info", place]))[0].clone();
        let (here, there) = (told(arg(&recording)), told("s3://bucket/recordings/left"));
        assert!(there.contains("frames") && here.lines().count() == there.lines().count(), "{here}\n{there}");
        server.put("maps/left/map.mcap", &fs::read(runs.run("left").join("map.mcap")).unwrap());
        let map = told("s3://bucket/maps/left");
        assert!(map.contains("keyframes"), "{map}");
        let refused = run(&server, &case, &["run", "s3://bucket/recordings/none"]);
        let [_, said] = texts(&refused);
        assert!(refused.status.code() == Some(1), "{said}");
        assert!(said.contains("s3://bucket/recordings/none: there is no recording\nhint: "), "{said}");
    }

    #[test]
    fn what_is_not_in_the_bucket_is_named_with_what_to_do() {
        let Some(server) = Server::begin() else { return };
        let (left, case) = (Runs::get().run("left"), Case::new());
        put_map(&server, Runs::get(), "left");
        let refused = |args: &[&str], words: &[&str]| {
            let output = run(&server, &case, args);
            let [_, said] = texts(&output);
            assert!(output.status.code() == Some(1), "{output:?}");
            assert!(words.iter().all(|word| said.contains(word)), "{said}");
        };
        let map = "s3://bucket/maps/left";
        refused(
            &["verdict", map, "s3://bucket/maps/none"],
            &["s3://bucket/maps/none/map.mcap: there is no map", "hint: "],
        );
        refused(&["propose", "s3://bucket/nothing/*"], &["s3://bucket/nothing/*: there is no map", "hint: "]);
        refused(&["propose", map], &["there is nothing to merge it with"]);
        put_map(&server, Runs::get(), "right");
        let absent =
            ["s3://absent/v/", ".verdict: cannot be ", "hint: does the bucket exist? AWS_ACCESS_KEY_ID"];
        refused(&["verdict", arg(&left), "s3://bucket/maps/right", "--verdicts", "s3://absent/v"], &absent);
    }

    /// Those keyframes of a map, as the map of another agent.
    fn part(map: &Map, name: &str, keeps: impl Fn(usize) -> bool) -> Map {
        let mut part = map.clone();
        let ids: Vec<KeyframeId> = part.keyframes.keys().copied().collect();
        let kept = |id: &KeyframeId| ids.iter().position(|other| other == id).is_some_and(&keeps);
        part.keyframes.retain(|id, _| kept(id));
        part.edges.retain(|edge| kept(&edge.from) && kept(&edge.to));
        part.frames.retain(|frame| kept(&frame.reference));
        for agent in part.agents.values_mut() {
            (agent.name, agent.identity) = (name.to_owned(), None);
        }
        part
    }

    /// Two halves of every run, in files of this machine.
    fn halves(runs: &Runs, case: &Case) -> Vec<(String, std::path::PathBuf)> {
        let mut all = Vec::new();
        for run in ["left", "right", "elsewhere"] {
            let map = runs.map(run);
            let middle = map.keyframes.len() / 2;
            for (name, is_first) in [(format!("{run}-1"), true), (format!("{run}-2"), false)] {
                let file = case.path(&format!("{name}.mcap"));
                map::save_map(&file, &part(&map, &name, |number| (number < middle) == is_first)).unwrap();
                all.push((name, file));
            }
        }
        all
    }

    /// Workers on the bucket, one of which is killed every now and then and followed by another, until so many verdicts are there; how many
    /// were killed.
    fn work_and_kill(server: &Server, case: &Case, wanted: usize) -> usize {
        let begin = || {
            let mut worker =
                command(server, case, &["worker", "--store", "s3://bucket/", "--quiet", "-j", "1"]);
            worker.stdout(Stdio::null()).spawn().expect("loopbox starts")
        };
        let mut workers: Vec<Child> = (0..4).map(|_| begin()).collect();
        let (begun, mut killed, mut chance) = (Instant::now(), 0, 42_u64);
        while server.names("verdicts/").len() < wanted {
            assert!(begun.elapsed() < Duration::from_secs(400), "{:?}", server.names("verdicts/"));
            chance = chance.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            std::thread::sleep(Duration::from_millis(200 + (chance >> 33) % 1500));
            let one = &mut workers[(chance >> 20) as usize % 4];
            one.kill().unwrap();
            one.wait().unwrap();
            *one = begin();
            killed += 1;
        }
        for worker in &mut workers {
            worker.kill().unwrap();
            worker.wait().unwrap();
        }
        killed
    }

    #[test]
    fn four_workers_on_a_bucket_are_killed_at_random_and_nothing_is_lost() {
        let Some(server) = Server::begin() else { return };
        let (runs, case) = (Runs::get(), Case::new());
        let maps = halves(runs, &case);
        maps.iter()
            .for_each(|(name, file)| server.put(&format!("maps/{name}/map.mcap"), &fs::read(file).unwrap()));
        let killed = work_and_kill(&server, &case, 15);
        assert!(killed >= 4, "only {killed} workers were killed");
        let output = run(&server, &case, &["worker", "--store", "s3://bucket", "--once"]);
        let [_, said] = texts(&output);
        assert!(output.status.success() && said.contains("0 pairs of maps judged here"), "{said}");

        let merge = |maps: &[&str], verdicts: &str, out: &str| {
            let out = case.path(out);
            let args = [&["merge"], maps, &["--verdicts", verdicts, "--out", arg(&out)]].concat();
            let output = run(&server, &case, &args);
            assert!(output.status.success(), "{:?}", texts(&output));
            let [_, said] = texts(&output);
            (said, fs::read(out.join("map.mcap")).unwrap())
        };
        // One process, with nothing but its own files.
        let alone = case.path("alone");
        let files: Vec<&str> = maps.iter().map(|(_, file)| arg(file)).collect();
        let (_, map) = merge(&files, arg(&alone), "one");
        let entries = fs::read_dir(&alone).unwrap().map(|entry| entry.unwrap().path());
        let own: BTreeMap<String, Vec<u8>> = entries
            .map(|path| (path.file_name().unwrap().to_string_lossy().into_owned(), fs::read(&path).unwrap()))
            .collect();
        let names = server.names("verdicts/");
        let kept: BTreeMap<String, Vec<u8>> = names
            .iter()
            .map(|name| (name.trim_start_matches("verdicts/").to_owned(), server.get(name)))
            .collect();
        assert!(own == kept, "other verdicts: {:?} and {:?}", own.keys(), kept.keys());
        let (said, same) = merge(&files, "s3://bucket/verdicts", "many");
        assert!(!said.contains("looking where"), "a verdict is lost: {said}");
        assert!(map == same, "another map");
    }
}
