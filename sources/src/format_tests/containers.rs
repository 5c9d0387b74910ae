//! Images as messages in files.

use super::*;
use crate::recording::EncodedPicture;

/// How a message of a time is made.
type Made = fn(u64) -> Vec<u8>;

/// Four messages of a form, of which the first is the `from`th.
fn messages(
    of: Made,
    schema: &'static str,
    encoding: &'static str,
    which: std::ops::Range<usize>,
) -> Vec<(&'static str, &'static str, &'static str, u64, Vec<u8>)> {
    which.map(|i| ("/cam", schema, encoding, nanoseconds(i), of(nanoseconds(i)))).collect()
}

#[test]
fn messages_of_every_form_in_mcap() {
    let room = tempdir().unwrap();
    let packed: Made = |time| zstd::encode_all(&cdr(time)[..], 3).unwrap();
    let json: Made = |time| {
        let data = base64::Engine::encode(&base64::engine::general_purpose::STANDARD, png());
        let stamp = format!("{{\"sec\":{},\"nsec\":{}}}", time / 1_000_000_000, time % 1_000_000_000);
        format!("{{\"timestamp\":{stamp},\"format\":\"png\",\"data\":\"{data}\"}}").into_bytes()
    };
    let forms: [(&str, Made, &str, &str); 5] = [
        ("compressed", foxglove_compressed, "foxglove.CompressedImage", "protobuf"),
        ("raw", foxglove_raw, "foxglove.RawImage", "protobuf"),
        ("json", json, "foxglove.CompressedImage", "json"),
        ("cdr", cdr, "sensor_msgs/msg/Image", "cdr"),
        ("packed one by one", packed, "sensor_msgs/msg/Image", "cdr"),
    ];
    for (what, of, schema, encoding) in forms {
        for compression in [None, Some(Compression::Zstd), Some(Compression::Lz4)] {
            let path = room.path().join("a.mcap");
            mcap_file(&path, compression, &messages(of, schema, encoding, 0..4));
            assert_times(&read(&path), what);
        }
    }
}

#[test]
fn bags_in_parts_are_read_in_the_order_of_their_times() {
    // By their names 10 would come before 9, and the third begins the recording.
    let parts = [("bag_9.mcap", 1..3), ("bag_10.mcap", 3..4), ("bag_11.mcap", 0..1)];
    for with_metadata in [false, true] {
        let room = tempdir().unwrap();
        for (name, which) in parts.clone() {
            mcap_file(&room.path().join(name), None, &messages(cdr, "sensor_msgs/msg/Image", "cdr", which));
        }
        // One that holds none of the images.
        mcap_file(
            &room.path().join("bag_12.mcap"),
            None,
            &[("/imu", "sensor_msgs/msg/Imu", "cdr", 1, vec![0; 9])],
        );
        if with_metadata {
            fs::write(room.path().join("metadata.yaml"), "rosbag2_bagfile_information:\n").unwrap();
        }
        let seen = read(room.path());
        assert_times(&seen, "parts");
        assert!(seen.facts.contains("files: 3 in the order of their times"), "{}", seen.facts);
    }
    let room = tempdir().unwrap();
    let names = ["run_0.bag", "run_1.bag"];
    for (name, which) in names.into_iter().zip([0..2, 2..4]) {
        bag(&room.path().join(name), which);
    }
    assert_times(&read(room.path()), "bags");
    assert_eq!(read(&room.path().join(names[1])).times, TIMES[2..]);
}

/// A ROS 1 bag as `loopbox convert` writes it.
fn bag(path: &Path, which: std::ops::Range<usize>) {
    let mut draft = crate::convert::Draft::begin(path, &Head::default(), None).unwrap();
    for i in which {
        draft.frame(i as u64, TIMES[i], EncodedPicture { format: "png", bytes: png() }).unwrap();
    }
    draft.finish(&Default::default()).unwrap();
}

#[cfg(feature = "sqlite")]
#[test]
fn a_bag_in_sqlite_with_and_without_its_metadata() {
    for name in [None, Some("metadata.yaml")] {
        let room = tempdir().unwrap();
        let database = rusqlite::Connection::open(room.path().join("bag_0.db3")).unwrap();
        database
            .execute_batch(
                "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);
                 CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
                 INSERT INTO topics VALUES (1, '/cam', 'sensor_msgs/msg/Image', 'cdr');",
            )
            .unwrap();
        for i in 0..4 {
            let row = "INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?1, ?2)";
            database.execute(row, (nanoseconds(i) as i64, cdr(nanoseconds(i)))).unwrap();
        }
        drop(database);
        name.iter().for_each(|name| fs::write(room.path().join(name), "x").unwrap());
        assert_times(&read(room.path()), "db3");
    }
}

#[test]
fn constant_stamps_of_messages_are_replaced_by_the_recorders() {
    let room = tempdir().unwrap();
    let path = room.path().join("a.mcap");
    let still = |count: usize| -> Vec<_> {
        (0..count)
            .map(|i| ("/cam", "sensor_msgs/msg/Image", "cdr", nanoseconds(i), cdr(7_000_000_000)))
            .collect()
    };
    mcap_file(&path, None, &still(12));
    let seen = read(&path);
    assert_eq!(seen.times.len(), 12);
    assert!((seen.times[11] - 11.1).abs() < 1e-6 && seen.facts.contains("stand still"), "{:?}", seen.times);
}

#[test]
fn a_damaged_chunk_is_left_out_and_counted() {
    let room = tempdir().unwrap();
    let (path, topic) =
        (room.path().join("a.mcap"), messages(foxglove_raw, "foxglove.RawImage", "protobuf", 0..20));
    mcap_file(&path, Some(Compression::Zstd), &topic);
    let mut bytes = fs::read(&path).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let chunk = &summary.chunk_indexes[5];
    let start = (chunk.chunk_start_offset + chunk.chunk_length / 2) as usize;
    bytes[start..start + 12].fill(0xaa);
    fs::write(&path, bytes).unwrap();
    let seen = read(&path);
    assert!((15..20).contains(&seen.times.len()), "{}", seen.times.len());
    let missing = format!("{} are missing", 20 - seen.times.len());
    assert!(seen.reported.contains(&missing), "{}", seen.reported);

    // A bag of more than one chunk of 4 MiB.
    let path = room.path().join("a.bag");
    let mut draft = crate::convert::Draft::begin(&path, &Head::default(), None).unwrap();
    let mut padded = png();
    padded.resize(1 << 20, 0);
    for i in 0..16 {
        draft
            .frame(i, 10.0 + 0.1 * i as f64, EncodedPicture { format: "png", bytes: padded.clone() })
            .unwrap();
    }
    draft.finish(&Default::default()).unwrap();
    let mut bytes = fs::read(&path).unwrap();
    // The length of a message in the second chunk.
    let at = bytes.windows(4).enumerate().skip(5 << 20).find(|(_, w)| *w == b"conn").unwrap().0;
    bytes[at - 8..at].fill(0x7f);
    fs::write(&path, bytes).unwrap();
    let seen = read(&path);
    assert!((10..16).contains(&seen.times.len()), "{}", seen.times.len());
    assert!(
        seen.reported.contains("missing") && seen.times[seen.times.len() - 1] > 11.4,
        "{}",
        seen.reported
    );
}

#[test]
fn a_file_without_images_says_what_it_has() {
    let room = tempdir().unwrap();
    let path = room.path().join("a.mcap");
    mcap_file(&path, None, &[("/imu", "sensor_msgs/msg/Imu", "cdr", 1, vec![0; 9])]);
    let refusal = refused(&path);
    assert!(refusal.contains("/imu (1 × sensor_msgs/msg/Imu)"), "{refusal}");
}
