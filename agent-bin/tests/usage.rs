//! What the command line takes and how it refuses the rest, through the binary.

mod common;

use common::*;
use tempfile::tempdir;

#[test]
fn values_without_sense_are_wrong_usage() {
    let folder = tempdir().unwrap();
    timed_folder(folder.path(), 4);
    let out = folder.path().join("out");
    let run = |more: &[&'static str], words: &[&str]| {
        assert_misused(&[&["run", arg(folder.path()), "--out", arg(&out)], more].concat(), words);
    };
    run(&["--fps", "-5"], &["--fps -5 is not a frame rate"]);
    run(&["--threads", "0"], &["--threads must be 1 or more", "one per core"]);
    assert_misused(&["merge", "a", "b", "--out", "c", "-j", "0"], &["--threads must be 1 or more"]);
    assert_misused(&["agent", "--threads", "0"], &["--threads must be 1 or more"]);
    run(&["--realtime", "--speed", "0"], &["--speed 0"]);
    run(&["--fov", "400"], &["--fov 400", "degrees"]);
    run(&["--max-width", "20"], &["--max-width 20"]);
    run(&["--max-variance", "-1"], &["--max-variance"]);
    run(&["--start", "5", "--end", "3"], &["--start 5 is not before --end 3"]);
    run(&["--min-tracked", "2"], &["--min-tracked 2"]);
    run(&["--record", "walk.txt"], &["walk.txt", ".mcap"]);
    run(&["--duration", "3"], &["--duration is for cameras"]);
    run(&["--rate", "5"], &["--rate is for scans"]);
    assert_misused(&["run", "--out", arg(&out)], &["no source of images", "--camera"]);
    assert!(!out.exists());
}

#[test]
fn options_without_what_they_are_for_are_wrong_usage() {
    let folder = tempdir().unwrap();
    timed_folder(folder.path(), 4);
    let out = folder.path().join("out");
    let run = |more: &[&'static str], words: &[&str]| {
        assert_misused(&[&["run", arg(folder.path()), "--out", arg(&out)], more].concat(), words);
    };
    if cfg!(feature = "view") {
        run(&["--bind", "0.0.0.0"], &["--view"]);
        run(&["--token", "secret"], &["--view"]);
    }
    if cfg!(feature = "fleet") {
        run(&["--keys", "keys"], &["--keys is for --fleet"]);
    }
    assert!(!out.exists());
}

#[test]
fn the_version_names_commit_and_features() {
    let printed = |flag: &str| stdout(&loopbox(&[flag]));
    let (short, long) = (printed("-V"), printed("--version"));
    assert!(short.starts_with("loopbox 0.") && short.contains('(') && short.lines().count() == 1, "{short}");
    assert!(long.starts_with(short.trim_end()) && long.contains("features: "), "{long}");
    assert_eq!(long.contains(" sqlite"), cfg!(feature = "sqlite"), "{long}");
}

#[test]
fn shells_and_man_know_every_command_and_the_machine_is_described() {
    let folder = tempdir().unwrap();
    let pages = folder.path().join("man1");
    assert!(loopbox(&["man", arg(&pages)]).status.success());
    for (shell, line) in
        [("bash", "_loopbox()"), ("zsh", "#compdef loopbox"), ("fish", "complete -c loopbox")]
    {
        let text = stdout(&loopbox(&["completions", shell]));
        assert!(text.contains(line) && text.contains("max-width"), "{shell}");
    }
    for command in ["run", "merge", "doctor"] {
        let page = std::fs::read_to_string(pages.join(format!("loopbox-{command}.1"))).unwrap();
        assert!(page.contains(".SH SYNOPSIS") && page.contains("\\-\\-help"), "{page}");
    }
    let text = stdout(&loopbox(&["doctor"]));
    assert!(
        ["program", "machine", "results", "videos", "cameras"].iter().all(|what| text.contains(what)),
        "{text}"
    );
    let checks: serde_json::Value = serde_json::from_str(&stdout(&loopbox(&["doctor", "--json"]))).unwrap();
    assert_eq!(checks[0]["state"], "ok", "{checks:#}");
}

#[test]
fn a_recording_alone_is_enough() {
    let folder = tempdir().unwrap();
    let run = command().arg("run").arg(demo()).current_dir(folder.path()).output().unwrap();
    assert!(run.status.success(), "{}", stderr(&run));
    let name = demo().file_name().unwrap().to_owned();
    assert!(folder.path().join("out").join(name).join("map.mcap").is_file());
}

/// `-o`, `-f` and `-q` are the same wherever they are.
#[test]
fn short_options_are_the_same_everywhere() {
    let help = |command: &str| stdout(&loopbox(&[command, "--help"]));
    let commands = ["run", "merge", "record", "convert", "import", "unmerge", "verdict", "propose", "calib"];
    for text in commands.map(help) {
        for (long, short) in
            [("--out ", "-o, --out "), ("--force\n", "-f, --force\n"), ("--quiet\n", "-q, --quiet\n")]
        {
            assert!(!text.contains(&format!(" {long}")) || text.contains(short), "{text}");
        }
    }
}

#[cfg(target_os = "linux")]
#[test]
fn the_report_is_opened_where_that_is_wished() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempdir().unwrap();
    let (browser, seen, out) =
        (folder.path().join("xdg-open"), folder.path().join("seen"), folder.path().join("out"));
    write(browser.clone(), format!("#!/bin/sh\necho \"$1\" >{}\n", seen.display()));
    std::fs::set_permissions(&browser, std::fs::Permissions::from_mode(0o755)).unwrap();
    let run = |path: &std::path::Path| {
        let recording = demo();
        let args = ["run", arg(&recording), "--out", arg(&out), "--end", "1", "--quiet", "--open", "--force"];
        let run = command().args(args).env("PATH", path).output().unwrap();
        assert!(run.status.success(), "{}", stderr(&run));
        stderr(&run)
    };
    // Without a program that shows it the run is as good.
    assert!(run(&out).contains("report.html cannot be shown: xdg-open"));
    let path = format!("{}:/usr/bin:/bin", folder.path().display());
    run(std::path::Path::new(&path));
    let is_seen =
        || std::fs::read_to_string(&seen).is_ok_and(|text| text.trim_end().ends_with("out/report.html"));
    let begin = std::time::Instant::now();
    while !is_seen() {
        assert!(begin.elapsed().as_secs() < 60, "it is not opened");
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
}

/// An option whose value may lack does not take the recording for it.
#[test]
fn values_that_may_lack_follow_an_equals_sign() {
    let folder = tempdir().unwrap();
    let out = folder.path().join("out");
    let options: &[&str] = if cfg!(feature = "fleet") { &["--view", "--fleet"] } else { &[] };
    for option in options {
        // The recording is found, and has no images.
        assert_refused(&["run", option, arg(folder.path()), "--out", arg(&out)], &[arg(folder.path())]);
    }
}

#[test]
fn what_is_no_parameter_cannot_be_set() {
    let folder = tempdir().unwrap();
    timed_folder(folder.path(), 4);
    let out = folder.path().join("out");
    let wrong = |setting: &str, words: &[&str]| {
        assert_misused(&["run", arg(folder.path()), "--out", arg(&out), "--set", setting], words);
    };
    wrong("bootstrap.no_such=1", &["--set bootstrap.no_such=1", "`loopbox params` prints all"]);
    wrong("bootstrap.block=many", &["--set bootstrap.block=many"]);
    wrong("bootstrap", &["KEY=VALUE"]);
    assert!(!out.exists());
}

#[test]
fn the_last_line_of_a_run_names_the_report_and_quiet_keeps_warnings() {
    let out = tempdir().unwrap();
    let part = ["--end", "1.5"];
    let output = loopbox(&[&["run", arg(&demo()), "-o", arg(out.path())], &part[..]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let report = out.path().join("report.html");
    let last = stdout(&output).lines().last().unwrap_or_default().to_owned();
    assert!(report.is_file() && last.contains(arg(&report)), "{last}");
    assert_eq!(numbers(out.path())["commit"].is_string(), !stdout(&loopbox(&["-V"])).contains("no commit"));
    let folder = tempdir().unwrap();
    timed_folder(folder.path(), 9);
    write(folder.path().join("images/000003.png"), "no image");
    let output = loopbox(&["run", arg(folder.path()), "-q", "-f", "-o", arg(out.path())]);
    assert!(stderr(&output).contains("warning: frame 3 is skipped"), "{}", stderr(&output));
}

#[test]
fn help_has_headings_and_short_lines() {
    let help = stdout(&loopbox(&["run", "--help"]));
    for heading in ["Recording:", "Lens and sensor:", "Map and results:", "Live camera:", "LiDAR:"] {
        assert!(help.lines().any(|line| line == heading), "no {heading} in {help}");
    }
    let longest = help.lines().map(|line| line.chars().count()).max();
    assert!(longest <= Some(100), "{longest:?}");
}

#[cfg(not(all(feature = "view", feature = "fleet")))]
#[test]
fn commands_that_are_not_built_in_say_which_feature_brings_them() {
    let all = [
        ("view", "view", cfg!(feature = "view")),
        ("station", "fleet", cfg!(feature = "fleet")),
        ("fleet", "fleet", cfg!(feature = "fleet")),
        ("keys", "fleet", cfg!(feature = "fleet")),
    ];
    for (command, feature, _) in all.into_iter().filter(|(_, _, is_built_in)| !is_built_in) {
        assert_misused(
            &[command, "whatever", "--out", "x"],
            &["built without", &format!("--features {feature}")],
        );
    }
}
