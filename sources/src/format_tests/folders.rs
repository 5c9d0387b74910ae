//! Folders of images, and their tables.

use super::*;

/// A kind, its table and images, what the table says, and the rate that is given.
type Layout<'a> = (&'a str, &'a str, Vec<String>, &'a str, Option<f64>);

#[test]
fn folders_of_every_layout() {
    let four = |name: fn(usize) -> String| -> Vec<String> { (0..4).map(name).collect() };
    let rows: [Layout<'_>; 12] = [
        (
            "image folder with times.txt",
            "timestamps.csv",
            four(|i| format!("data/{i}.png")),
            "t,n\n10.0\n10.1\n10.2\n10.3\n",
            None,
        ),
        (
            "image folder with times.txt",
            "times.txt",
            four(|i| format!("images/{i}.png")),
            "10.0 images/0.png\n10.1 images/1.png\n10.2 images/2.png\n10.3 images/3.png\n",
            None,
        ),
        (
            "image folder with times.txt",
            "times.txt",
            four(|i| format!("images/{i}.png")),
            "10.0\n10.1\n10.2\n10.3\n",
            None,
        ),
        (
            "TUM RGB-D folder",
            "rgb.txt",
            four(|i| format!("rgb/{i}.png")),
            "# color images\n10.0 rgb/0.png\n10.1 rgb/1.png\n10.2 rgb/2.png\n10.3 rgb/3.png\n",
            None,
        ),
        (
            "TUM monoVO folder",
            "times.txt",
            four(|i| format!("images/0000{i}.jpg")),
            "00000 10.0 0.25\n00001 10.1 0.25\n00002 10.2 0.3\n00003 10.3 0.3\n",
            None,
        ),
        (
            "EuRoC folder",
            "mav0/cam0/data.csv",
            four(|i| format!("mav0/cam0/data/{}.png", 1_403_636_579_763_555_584 + 100_000_000 * i)),
            "#timestamp [ns],filename\n1403636579763555584,1403636579763555584.png\n1403636579863555584,1403636579863555584.png\n\
             1403636579963555584,1403636579963555584.png\n1403636580063555584,1403636580063555584.png\n",
            None,
        ),
        (
            "KITTI odometry folder",
            "times.txt",
            four(|i| format!("image_0/00000{i}.png")),
            "1.000000e+01\n1.010000e+01\n1.020000e+01\n1.030000e+01\n",
            None,
        ),
        (
            "KITTI raw folder",
            "image_02/timestamps.txt",
            four(|i| format!("image_02/data/000000000{i}.png")),
            "2011-09-26 13:02:25.900000000\n2011-09-26 13:02:26.000000000\n2011-09-26 13:02:26.100000000\n2011-09-26 13:02:26.200000000\n",
            None,
        ),
        (
            "folder of numbered images",
            "seq/none.txt",
            four(|i| format!("frame-00000{i}.color.png")),
            "7-Scenes",
            Some(10.0),
        ),
        ("folder of numbered images", "none.txt", four(|i| format!("{}.png", i + 9)), "numbers", Some(10.0)),
        (
            "folder of images named by their times",
            "none.txt",
            four(|i| format!("{}.png", 1_614_600_000_900 + 100 * i)),
            "names",
            None,
        ),
        (
            "folder of images named by their times",
            "none.txt",
            four(|i| format!("rgb_{:.6}.png", 1_305_031_102.9 + 0.1 * i as f64)),
            "names",
            None,
        ),
    ];
    for (kind, table, images, text, fps) in rows {
        let mut files: Vec<(&str, &[u8])> = images.iter().map(|name| (name.as_str(), &[][..])).collect();
        files.push((table, text.as_bytes()));
        let depths: Vec<String> = images.iter().map(|name| name.replace("color", "depth")).collect();
        files
            .extend(depths.iter().filter(|name| name.contains("depth")).map(|name| (name.as_str(), &[][..])));
        let room = folder(&files);
        let seen = read_at(room.path(), fps);
        assert_eq!(seen.kind, kind);
        assert_times(&seen, &format!("{kind} {text}"));
    }
}

/// Tables as other programs write them: those that the issue names, and others of the kind.
#[test]
fn tables_as_people_have_them() {
    let names = ["my images/img 0.png", "my images/img 1.png", "my images/img 2.png", "my images/img 3.png"];
    let line =
        |form: &dyn Fn(usize, &str) -> String| -> String { (0..4).map(|i| form(i, names[i])).collect() };
    let wide = |text: &str| text.encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<u8>>();
    let plain = line(&|i, name| format!("{} {name}\n", TIMES[i]));
    let tables: Vec<(&str, Vec<u8>)> = vec![
        ("blanks", plain.clone().into()),
        ("quotes", line(&|i, name| format!("{} \"{name}\"\n", TIMES[i])).into()),
        ("backslashes", line(&|i, name| format!("{} {}\n", TIMES[i], name.replace('/', "\\"))).into()),
        (
            "another computer's paths",
            line(&|i, name| format!("{} C:\\Users\\me\\run\\{}\n", TIMES[i], name.replace('/', "\\"))).into(),
        ),
        ("a mark at the start", [b"\xef\xbb\xbf", plain.as_bytes()].concat()),
        ("UTF-16", [&b"\xff\xfe"[..], &wide(&plain)].concat()),
        (
            "UTF-16 with a header and CRLF",
            [&b"\xff\xfe"[..], &wide(&format!("time file\r\n{}", plain.replace('\n', "\r\n")))].concat(),
        ),
        (
            "semicolons and a header",
            format!("timestamp;filename\n{}", line(&|i, name| format!("{};{name}\n", TIMES[i]))).into(),
        ),
        (
            "decimal commas",
            line(&|i, name| format!("{};{name}\n", TIMES[i].to_string().replace('.', ","))).into(),
        ),
        ("tabs", line(&|i, name| format!("{}\t{name}\t0.25\n", TIMES[i])).into()),
        (
            "commas, a header and more columns",
            format!("time,image,exposure\n{}", line(&|i, name| format!("{},{name},7\n", TIMES[i]))).into(),
        ),
        ("the image first", line(&|i, name| format!("{name},{}\n", TIMES[i])).into()),
        ("milliseconds", line(&|i, name| format!("{},{name}\n", 10_000 + 100 * i)).into()),
        (
            "microseconds since 1970",
            line(&|i, name| format!("{},{name}\n", 1_614_600_000_000_000u64 + 100_000 * i as u64)).into(),
        ),
        ("nanoseconds from zero", line(&|i, name| format!("{},{name}\n", 100_000_000 * i)).into()),
        (
            "named milliseconds",
            format!("t [ms],image\n{}", line(&|i, name| format!("{:.3},{name}\n", 100.0 * i as f64))).into(),
        ),
        ("dates", line(&|i, name| format!("2024-05-01 10:00:10.{i}00,{name}\n")).into()),
        ("lines that end by a carriage return alone", plain.replace('\n', "\r").into()),
        (
            "the image first, and a header",
            format!("filename,timestamp\n{}", line(&|i, name| format!("{name},{}\n", TIMES[i]))).into(),
        ),
        (
            "an index before them, as pandas writes it",
            format!(",timestamp,filename\n{}", line(&|i, name| format!("{i},{},{name}\n", TIMES[i]))).into(),
        ),
        (
            "a number, the time, the exposure and the image",
            line(&|i, name| format!("{} {} {} {name}\n", i + 1, TIMES[i], [8, 9, 7, 8][i])).into(),
        ),
        (
            "secs and nsecs in two columns",
            format!("secs,nsecs,filename\n{}", line(&|i, name| format!("10,{},{name}\n", 100_000_000 * i)))
                .into(),
        ),
        (
            "epoch secs and nsecs without a header",
            line(&|i, name| {
                format!("{} {:09} {name}\n", 1_700_000_000 + (i + 8) / 10, (i + 8) % 10 * 100_000_000)
            })
            .into(),
        ),
        (
            "tv_sec and tv_usec behind the image",
            format!("image;tv_sec;tv_usec\n{}", line(&|i, name| format!("{name};10;{}\n", 100_000 * i)))
                .into(),
        ),
        ("in no order", [2, 0, 3, 1].map(|i| format!("{} {}\n", TIMES[i], names[i])).concat().into()),
    ];
    for (what, table) in tables {
        let mut files: Vec<(&str, &[u8])> = names.iter().map(|name| (*name, &[][..])).collect();
        files.push(("times.txt", &table));
        let seen = read(folder(&files).path());
        assert_times(&seen, what);
        let is_of_unit = what.contains("seconds");
        assert_eq!(seen.facts.contains("seconds, by their steps"), is_of_unit, "{what}: {}", seen.facts);
    }
}

#[test]
fn times_of_missing_images_are_nobody_elses() {
    let times: String = (0..9).map(|i| format!("{:.1}\n", 10.0 + 0.1 * f64::from(i))).collect();
    for (layout, names) in [
        ("image_0", ["000000.png", "000003.png", "000004.png", "000008.png"]),
        ("images", ["frame0.png", "frame3.png", "frame4.png", "frame8.png"]),
        // Counted from 1.
        ("images", ["1.jpg", "4.jpg", "5.jpg", "9.jpg"]),
    ] {
        let names = names.map(|name| format!("{layout}/{name}"));
        let mut files: Vec<(&str, &[u8])> = names.iter().map(|name| (name.as_str(), &[][..])).collect();
        files.push(("times.txt", times.as_bytes()));
        let seen = read(folder(&files).path());
        assert_eq!(seen.times, [10.0, 10.3, 10.4, 10.8], "{names:?}");
        assert!(seen.reported.contains("9 times for 4 images"), "{}", seen.reported);
    }
    let room = folder(&[("times.txt", times.as_bytes()), ("images/a.png", b""), ("images/b.png", b"")]);
    assert!(refused(room.path()).contains("9 times for 2 images"));
    // Of a table with names the others are there.
    let room =
        folder(&[("times.txt", b"10.0 a.png\n10.1 b.png\n10.2 c.png\n"), ("a.png", b""), ("c.png", b"")]);
    let seen = read(room.path());
    assert_eq!((seen.times, seen.reasons.len()), (vec![10.0, 10.2], 1));
    let room = folder(&[("1.png", b""), ("2.png", b""), ("6.png", b""), ("7.png", b"")]);
    assert!(read_at(room.path(), Some(10.0)).reported.contains("after 2 comes 6 (3 missing)"));
}

/// A folder of so many images with these times.
fn timed(times: &[f64]) -> TempDir {
    let names: Vec<String> = (0..times.len()).map(|i| format!("{i}.png")).collect();
    let table: String = times.iter().zip(&names).map(|(time, name)| format!("{time:?} {name}\n")).collect();
    let mut files: Vec<(&str, &[u8])> = names.iter().map(|name| (name.as_str(), &[][..])).collect();
    files.push(("times.txt", table.as_bytes()));
    folder(&files)
}

fn steady(count: usize) -> Vec<f64> {
    (0..count).map(|i| 100.0 + 0.1 * i as f64).collect()
}

#[test]
fn time_that_does_not_go_forward() {
    let changed = |change: &dyn Fn(&mut Vec<f64>)| {
        let mut times = steady(40);
        change(&mut times);
        read(timed(&times).path())
    };
    // Named in the issue: a stamp in the future, a clock set back, one set ahead, the same all along.
    let future = changed(&|times| times[3] = 2e9);
    assert_eq!((future.times.len(), future.reasons.len()), (39, 1));
    assert!(future.reasons[0].contains("lies off"), "{:?}", future.reasons);
    let back = changed(&|times| times[20..].iter_mut().for_each(|t| *t -= 1.5));
    assert_eq!(back.times.len(), 40);
    assert!(back.reported.contains("set back by 1.500 s at frame 20"), "{}", back.reported);
    let ahead = changed(&|times| times[20..].iter_mut().for_each(|t| *t += 1.7e9));
    assert!(
        (ahead.times[39] - 103.9).abs() < 1e-6 && ahead.reported.contains("set ahead"),
        "{}",
        ahead.reported
    );
    assert!(refused(timed(&[5.0; 9]).path()).contains("all 9 images have the time 5"));
    assert_eq!(read_at(timed(&[5.0; 9]).path(), Some(10.0)).times[8], 0.8);
    // Others: a pause, a first stamp that nobody set, a list that runs backwards, one that is played twice.
    let pause = changed(&|times| times[20..].iter_mut().for_each(|t| *t += 600.0));
    assert!((pause.times[39] - 703.9).abs() < 1e-6 && pause.reported.is_empty(), "{}", pause.reported);
    let unset = changed(&|times| times[0] = 0.0);
    assert_eq!((unset.times.len(), unset.times[0]), (39, 100.1));
    let backwards = changed(&|times| times.reverse());
    assert_eq!((backwards.times.len(), backwards.times[0]), (40, 100.0));
    let twice = changed(&|times| times.extend(steady(40)));
    assert_eq!(twice.times.len(), 80);
}

/// A folder's kind is told from what is in it, whatever its table and its folders are called.
#[test]
fn folders_without_a_table_of_a_known_name() {
    let rgb: Vec<String> = (0..4).map(|i| format!("rgb/{i}.png")).collect();
    let depth: Vec<String> = (0..4).map(|i| format!("depth/{i}.png")).collect();
    let both = |table: Option<(&str, String)>| {
        let images = rgb.iter().chain(&depth);
        let mut files: Vec<(&str, &[u8])> = images.map(|name| (name.as_str(), &[][..])).collect();
        files.extend(table.iter().map(|(name, text)| (*name, text.as_bytes())));
        folder(&files)
    };
    let rows = |row: &dyn Fn(usize) -> String| (0..4).map(row).collect::<String>();
    // What the TUM RGB-D benchmark's associate.py writes, in both orders, and a table of another program.
    for (name, text) in [
        ("associations.txt", rows(&|i| format!("{0} {1} {0:.3} {2}\n", TIMES[i], rgb[i], depth[i]))),
        ("fr1_desk.txt", rows(&|i| format!("{:.3} {} {} {}\n", TIMES[i] + 0.01, depth[i], TIMES[i], rgb[i]))),
        ("frames.csv", format!("frame,file,time\n{}", rows(&|i| format!("{i},{},{}\n", rgb[i], TIMES[i])))),
    ] {
        let seen = read(both(Some((name, text))).path());
        assert_times(&seen, name);
        assert!(seen.facts.contains(&format!("table: {name}")), "{}", seen.facts);
    }
    // Numbers that a program gives images are no times.
    let labels = rows(&|i| format!("{},{}\n", rgb[i], [3, 1, 2, 0][i]));
    let room = both(Some(("labels.csv", labels)));
    assert!(refused(room.path()).contains("--fps 30"), "{}", refused(room.path()));
    assert_times(&read_at(room.path(), Some(10.0)), "labels.csv");
    for scene in ["color", "cam0", "left"] {
        let images: Vec<String> = rgb.iter().map(|name| name.replace("rgb", scene)).collect();
        let all = images.iter().chain(&depth);
        let mut files: Vec<(&str, &[u8])> = all.map(|name| (name.as_str(), &[][..])).collect();
        files.push(("right/0.png", &[]));
        let room = folder(&files);
        assert_times(&read_at(room.path(), Some(10.0)), scene);
        assert!(refused(room.path()).contains("4 images but no time stamps"));
    }
    let room = folder(&[("times.txt", b"0.0\n0.1\n"), ("images/0.png", &[]), ("images/1.png", &[])]);
    let refusal = refused(&room.path().join("images"));
    assert!(
        refusal.contains("hint: the recording is the folder") && refusal.contains("has their times"),
        "{refusal}"
    );
    let room = folder(&[("front/0.png", &[]), ("rear/0.png", &[]), ("depth/0.png", &[])]);
    let refusal = refused(room.path());
    assert!(refusal.contains("give that folder or file itself, of depth/, front/, rear/"), "{refusal}");
}

/// The images of a table may have been converted, or moved.
#[test]
fn images_of_a_table_are_found_by_their_names_without_an_end() {
    for (place, name) in [("images", "00000#"), ("images", "images/00000#.jpg"), ("rgb", "00000#.bmp")] {
        let names: Vec<String> = (0..4).map(|i| format!("{place}/00000{i}.png")).collect();
        let row = |i: usize| format!("{} {}\n", TIMES[i], name.replace('#', &i.to_string()));
        let table: String = (0..4).map(row).collect();
        let mut files: Vec<(&str, &[u8])> = names.iter().map(|name| (name.as_str(), &[][..])).collect();
        files.push(("times.txt", table.as_bytes()));
        let seen = read(folder(&files).path());
        assert_times(&seen, name);
        assert!(seen.reported.contains("of the same names"), "{}", seen.reported);
    }
}

/// Times alone, in two columns.
#[test]
fn times_alone_of_two_columns_are_those_of_the_images() {
    let names: Vec<String> = (0..4).map(|i| format!("images/frame_{i}.png")).collect();
    for table in [
        "1700000000 800000000\n1700000000 900000000\n1700000001 0\n1700000001 100000000\n",
        "# secs nsecs\nsec,nsec\n10,0\n10,100000000\n10,200000000\n10,300000000\n",
        "1700000000 800000\n1700000000 900000\n1700000001 000000\n1700000001 100000\n",
    ] {
        let mut files: Vec<(&str, &[u8])> = names.iter().map(|name| (name.as_str(), &[][..])).collect();
        files.push(("times.txt", table.as_bytes()));
        assert_times(&read(folder(&files).path()), table);
    }
}
