//! Maps and verdicts in a bucket, of an S3 server from PyPI (moto) on this machine: the feature `object-store`. `script/buckets` installs
//! the server and runs these; `LOOPBOX_MOTO` names its program.

use crate::support::{Case, Runs, arg, loopbox};

#[cfg(not(feature = "object-store"))]
#[test]
fn a_build_without_buckets_names_the_feature() {
    let (left, case) = (Runs::get().run("left"), Case::new());
    let refusal = ["this loopbox was built without buckets", "hint: ", "--features object-store"];
    let bucket = "s3://bucket/verdicts";
    loopbox(&["verdict", arg(&left), arg(&left), "--verdicts", bucket]).assert_refused(&refusal);
    loopbox(&["propose", "gs://bucket/maps/*"]).assert_refused(&refusal);
    loopbox(&["merge", arg(&left), "az://box/a", "--out", arg(&case.out())]).assert_refused(&refusal);
    assert!(!case.out().exists());
}

#[cfg(feature = "object-store")]
mod served {
    use super::{Case, Runs, arg};
    use std::fs;
    use std::io::{Read, Write};
    use std::net::{TcpListener, TcpStream};
    use std::path::Path;
    use std::process::{Child, Command, Output, Stdio};
    use std::time::{Duration, Instant};

    /// That a request is signed, which the server asks for, and by whom, which it does not check.
    const SIGNED: &str = "AWS4-HMAC-SHA256 Credential=anybody/20260101/us-east-1/s3/aws4_request, SignedHeaders=host, Signature=0";

    /// An S3 server with a bucket, which ends with the test.
    struct Server {
        process: Child,
        port: u16,
    }

    impl Server {
        /// Nothing where there is no server's program.
        fn begin() -> Option<Self> {
            let program = std::env::var_os("LOOPBOX_MOTO").unwrap_or_else(|| "moto_server".into());
            let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
            let mut command = Command::new(program);
            command.args(["-H", "127.0.0.1", "-p", &port.to_string()]);
            let Ok(process) = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn() else {
                eprintln!(
                    "SKIPPED: no moto_server here, nothing was kept in a bucket (script/buckets installs it)"
                );
                return None;
            };
            let server = Self { process, port };
            let begun = Instant::now();
            while TcpStream::connect(("127.0.0.1", port)).is_err() {
                assert!(begun.elapsed() < Duration::from_secs(60), "the server does not answer");
                std::thread::sleep(Duration::from_millis(100));
            }
            server.ask("PUT", "/bucket", b"");
            Some(server)
        }

        /// What the server answers, without the head of it.
        fn ask(&self, method: &str, path: &str, body: &[u8]) -> Vec<u8> {
            let mut link = TcpStream::connect(("127.0.0.1", self.port)).unwrap();
            let head = format!(
                "{method} {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: {SIGNED}\r\nConnection: close\r\nContent-Length: \
                 {}\r\n\r\n",
                body.len()
            );
            link.write_all(head.as_bytes()).unwrap();
            link.write_all(body).unwrap();
            let mut answer = Vec::new();
            link.read_to_end(&mut answer).unwrap();
            let end = answer.windows(4).position(|four| four == b"\r\n\r\n").unwrap();
            let (head, body) = answer.split_at(end + 4);
            let head = String::from_utf8_lossy(head);
            assert!(
                head.starts_with("HTTP/1.1 200"),
                "{method} {path}: {head}{}",
                String::from_utf8_lossy(body)
            );
            body.to_vec()
        }

        /// The names of the objects under a prefix.
        fn names(&self, prefix: &str) -> Vec<String> {
            let list = self.ask("GET", &format!("/bucket?list-type=2&prefix={prefix}"), b"");
            let list = String::from_utf8(list).unwrap();
            list.split("<Key>").skip(1).map(|rest| rest.split("</Key>").next().unwrap().to_owned()).collect()
        }

        fn put_map(&self, runs: &Runs, name: &str) {
            let map = fs::read(runs.run(name).join("map.mcap")).unwrap();
            self.ask("PUT", &format!("/bucket/maps/{name}/map.mcap"), &map);
        }

        fn command(&self, case: &Case, args: &[&str]) -> Command {
            let mut command = Command::new(env!("CARGO_BIN_EXE_loopbox"));
            command.args(args).env("XDG_CACHE_HOME", case.path("cache"));
            for (name, value) in [
                ("AWS_ENDPOINT_URL", &*format!("http://127.0.0.1:{}", self.port)),
                ("AWS_ALLOW_HTTP", "true"),
                ("AWS_ACCESS_KEY_ID", "anybody"),
                ("AWS_SECRET_ACCESS_KEY", "anything"),
                ("AWS_REGION", "us-east-1"),
            ] {
                command.env(name, value);
            }
            command
        }

        fn loopbox(&self, case: &Case, args: &[&str]) -> Output {
            self.command(case, args).output().unwrap()
        }
    }

    impl Drop for Server {
        fn drop(&mut self) {
            // Nothing to be done where it ended by itself.
            let _ = self.process.kill().and_then(|()| self.process.wait());
        }
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
        ["left", "right"].iter().for_each(|name| server.put_map(runs, name));
        let [a, b] = ["s3://bucket/maps/left", "s3://bucket/maps/right/map.mcap"];
        let begin = |number: usize| {
            let (first, second) = if number.is_multiple_of(2) { (a, b) } else { (b, a) };
            let args = ["verdict", first, second, "--quiet", "--verdicts", "s3://bucket/verdicts/"];
            server.command(&case, &args).stdout(Stdio::null()).spawn().expect("loopbox starts")
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
        let kept = server.ask("GET", &format!("/bucket/{}", names[0]), b"");

        // In a folder, by the runs' own files, it has the same name and is the same to the byte.
        let folder = case.path("folder");
        let uri = format!("file://{}", arg(&folder));
        let (left, right) = (runs.run("left"), runs.run("right"));
        let output = server.loopbox(&case, &["verdict", arg(&left), arg(&right), "--verdicts", &uri]);
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
        ["left", "right", "elsewhere"].iter().for_each(|name| server.put_map(runs, name));
        let proposed = server.loopbox(&case, &["propose", "s3://bucket/maps/*", "--json", "--quiet"]);
        let [proposed, said] = texts(&proposed);
        let pairs: serde_json::Value = serde_json::from_str(&proposed).expect(&said);
        let likeliest = &pairs[0]["maps"];
        assert_eq!(likeliest[0], "s3://bucket/maps/left/map.mcap", "{pairs}");
        assert_eq!(likeliest[1], "s3://bucket/maps/right/map.mcap", "{pairs}");

        let merge = |maps: &[&str], verdicts: &str, out: &Path| {
            let args = [&["merge"], maps, &["--verdicts", verdicts, "--out", arg(out)]].concat();
            let output = server.loopbox(&case, &args);
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
    fn what_is_not_in_the_bucket_is_named_with_what_to_do() {
        let Some(server) = Server::begin() else { return };
        let (left, case) = (Runs::get().run("left"), Case::new());
        server.put_map(Runs::get(), "left");
        let refused = |args: &[&str], words: &[&str]| {
            let output = server.loopbox(&case, args);
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
        server.put_map(Runs::get(), "right");
        let absent =
            ["s3://absent/v/", ".verdict: cannot be ", "hint: does the bucket exist? AWS_ACCESS_KEY_ID"];
        refused(&["verdict", arg(&left), "s3://bucket/maps/right", "--verdicts", "s3://absent/v"], &absent);
    }
}
