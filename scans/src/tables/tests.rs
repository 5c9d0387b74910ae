use super::order::natural_key;
use super::*;

fn fields(text: &str) -> Vec<Vec<String>> {
    Table::parse(text).rows.into_iter().map(|row| row.fields).collect()
}

#[test]
fn fields_are_found_however_they_are_separated() {
    let expected = [["0.0", "a.png"], ["0.1", "b.png"]];
    for text in [
        "0.0 a.png\n0.1 b.png\n",
        "# seconds image\n0.0 a.png\n\n0.1 b.png",
        "timestamp filename\r\n0.0 a.png\r\n0.1 b.png\r\n",
        "0.0,a.png\n0.1, b.png\n",
        "time;image\n0.0;a.png\n0.1;b.png\n",
        "time;image\n0,0;a.png\n0,1;b.png\n",
        "0,0 a.png\n0,1 b.png\n",
        "0.0\ta.png\n0.1\tb.png\n",
        "\"0.0\",\"a.png\"\n\"0.1\",\"b.png\"\n",
        "0.0 \"a.png\"\n0.1 \"b.png\"\n",
    ] {
        assert_eq!(fields(text), expected, "{text}");
    }
    assert_eq!(fields("1 a#1.png # the first\n"), [["1", "a#1.png"]]);
    assert_eq!(fields("1;my image.png;7\n"), [["1", "my image.png", "7"]]);
    assert_eq!(fields("2011-09-26 13:02:25.5\n"), [["2011-09-26 13:02:25.5"]]);
    assert_eq!(fields("\"\t\"\n"), [[""]], "quotes around nothing, with which tables of tabs end");
    assert_eq!(fields(""), Vec::<Vec<String>>::new());
}

#[test]
fn texts_of_other_systems_are_read() {
    let text = "0.0 a.png\n0.1 ü.png\n";
    let wide = |order: fn(u16) -> [u8; 2]| text.encode_utf16().flat_map(order).collect::<Vec<u8>>();
    let (little, big) = (wide(u16::to_le_bytes), wide(u16::to_be_bytes));
    for bytes in [
        text.as_bytes().to_vec(),
        [b"\xef\xbb\xbf", text.as_bytes()].concat(),
        [b"\xff\xfe".as_slice(), &little].concat(),
        [b"\xfe\xff".as_slice(), &big].concat(),
        little,
        big,
        b"0.0 a.png\n0.1 \xfc.png\n".to_vec(),
    ] {
        assert_eq!(decoded(&bytes), text);
    }
}

#[test]
fn files_are_found_by_what_names_them() {
    let room = tempfile::tempdir().unwrap();
    let file = |name: &str| {
        let path = room.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, "").unwrap();
        path
    };
    let (plain, blanks, deep) = (file("a.png"), file("rgb/my first image.png"), file("cam 0/left/1.png"));
    for (line, expected) in [
        ("1 a.png", &plain),
        ("1 a.png 0.25 7", &plain),
        ("1 ./a.png", &plain),
        ("1 rgb/my first image.png", &blanks),
        ("1 rgb/my first image.png depth/1.png", &blanks),
        ("1 rgb\\my first image.png", &blanks),
        ("1;rgb\\my first image.png;0.5", &blanks),
        ("1 \"cam 0/left/1.png\"", &deep),
        ("1,C:\\data\\run 7\\cam 0\\left\\1.png", &deep),
        ("1 /home/somebody/run/cam 0/left/1.png", &deep),
    ] {
        let table = Table::parse(line);
        assert_eq!(table.rows[0].file(1, room.path()).as_ref(), Some(expected), "{line}");
    }
    let missing = Table::parse("1 rgb/no such.png x").rows[0].file(1, room.path());
    assert_eq!(missing, Some(room.path().join("rgb/no such.png")));
    assert_eq!(Table::parse("1").rows[0].file(1, room.path()), None);
}

#[test]
fn the_unit_is_recognised_by_steps_and_size() {
    use Unit::{Microseconds, Milliseconds, Nanoseconds, Seconds};
    let inferred = |first: f64, step: f64, fractions: bool| {
        let values: Vec<f64> = (0..50).map(|i| first + step * f64::from(i)).collect();
        Unit::infer(&values, fractions, "")
    };
    // Rates of cameras and LiDARs, from zero and from 1970, in every unit.
    for unit in Unit::ALL {
        let per_second = unit.per_second() as f64;
        for rate in [3.0, 10.0, 20.0, 30.0, 59.94, 100.0] {
            for from in [0.0, 1.4e9, 1.76e9] {
                let first = from * per_second;
                assert_eq!(inferred(first, per_second / rate, unit == Seconds), unit, "{rate} from {from}");
            }
        }
    }
    // A picture now and then, or a count of seconds.
    for (first, step, fractions, expected) in [
        (0.0, 1.0, false, Seconds),
        (0.0, 5.0, true, Seconds),
        (1.5e9, 60.0, false, Seconds),
        (0.0, 5.0, false, Milliseconds),
        (1.5e12, 2000.0, false, Milliseconds),
        (1.5e15, 4000.0, false, Microseconds),
        (0.0, 33.367, true, Milliseconds),
        (7.2e12, 5e7, false, Nanoseconds),
    ] {
        assert_eq!(inferred(first, step, fractions), expected, "{first} {step}");
    }
    let named = |header: &str| Unit::infer(&[0.0, 2.0, 4.0], false, header);
    assert_eq!(named("#timestamp [ms],filename"), Milliseconds);
    assert_eq!(named("time_us image"), Microseconds);
    assert_eq!(named("image"), Seconds);
}

#[test]
fn stamps_keep_their_digits() {
    let read = |text: &str| Table::parse(text).stamps().unwrap();
    assert_eq!(read("1403636579763555584,a\n1403636579813555456,b\n").seconds[0], 1_403_636_579.763_555_5);
    assert_eq!(read("0\n33333\n66666\n").seconds, [0.0, 0.033333, 0.066666]);
    assert_eq!(
        read("1305031102.175304 a\n1305031102.211214 b\n").seconds,
        [1305031102.175304, 1305031102.211214]
    );
    assert_eq!(read("0.000000e+00\n1.036224e-01\n").seconds, [0.0, 0.1036224]);
    let dates = read("2011-09-26 13:02:25.594360375\n2011-09-26 13:02:25.697560375\n");
    assert_eq!((dates.seconds[0], dates.unit), (1_317_042_145.594_360_4, None));
    for (text, line) in
        [("0.0 a\nnan b\n", 2), ("0.0 a\nx b\n", 2), ("a b\nc d\n", 1), ("0.1\n2011-09-26 13:02:25\n", 1)]
    {
        assert_eq!(Table::parse(text).stamps().unwrap_err().line, line, "{text}");
    }
}

#[test]
fn nanoseconds_without_zeros_before_them_are_counted() {
    let stamp = |i: u64| (1_700_000_000 + i / 15, i % 15 * 66_666_999);
    let texts: Vec<String> = (0..45).map(stamp).map(|(s, ns)| format!("{s}.{ns}")).collect();
    let stamps = Stamps::parse(texts.iter().map(String::as_str), "").unwrap();
    assert!(stamps.seconds.windows(2).all(|pair| (0.06..0.07).contains(&(pair[1] - pair[0]))));
    // Decimals of all lengths stay what they are.
    let texts: Vec<String> = (0..40).map(|i| format!("{}", 1.7e9 + 0.05 * f64::from(i))).collect();
    let stamps = Stamps::parse(texts.iter().map(String::as_str), "").unwrap();
    assert!(stamps.seconds.windows(2).all(|pair| (0.04..0.06).contains(&(pair[1] - pair[0]))));
}

#[test]
fn dates_are_distinguished_from_other_numbers() {
    assert_eq!(moment("1970-01-01 00:00:01"), Some(1_000_000_000));
    assert_eq!(moment("2000-02-29T12:30:00.5Z"), Some(951_827_400_500_000_000));
    assert_eq!(moment("2024/12/31 23:59:59,25"), Some(1_735_689_599_250_000_000));
    for none in ["2011-09-26", "1 2 3", "2011-13-26 13:02:25", "1.5", "", "2011-09-26 25:02:25", "12:00:00"] {
        assert_eq!(moment(none), None, "{none}");
    }
}

#[test]
fn gaps_in_numbers_are_reported() {
    let gaps = |names: &[&str]| Numbers::of(names.iter().map(Path::new)).and_then(|numbers| numbers.gaps());
    assert_eq!(gaps(&["0.bin", "1.bin", "2.bin"]), None);
    assert_eq!(gaps(&["f010.png", "f020.png", "f030.png"]), None);
    let inferred = gaps(&["cam0_0001.png", "cam0_0002.png", "cam0_0006.png", "cam0_0007.png"]).unwrap();
    assert!(inferred.contains("after 2 comes 6 (3 missing)"), "{inferred}");
    let inferred = gaps(&["0", "1", "3", "4", "7"].map(|n| n)).unwrap();
    assert!(inferred.contains("after 1 comes 3 (3 missing, in 2 places)"), "{inferred}");
    assert_eq!(gaps(&["a.png", "b.png"]), None);
    let places = |names: &[&str], count| {
        Numbers::of(names.iter().map(Path::new)).and_then(|numbers| numbers.places_in(count))
    };
    assert_eq!(places(&["000000.png", "000003.png"], 5), Some(vec![0, 3]));
    assert_eq!(places(&["2.png", "5.png"], 5), Some(vec![1, 4]));
    assert_eq!(places(&["2.png", "6.png"], 5), None);
    let mut names = ["f10.png", "f2.png", "f1.png", "e3.png"];
    names.sort_by_cached_key(|name| natural_key(name));
    assert_eq!(names, ["e3.png", "f1.png", "f2.png", "f10.png"]);
    for sorted in [
        &["f_0.png", "f_0.5.png", "f_1.png", "f_1.5.png", "f_10.png"][..],
        &["-20.png", "-3.png", "0.png", "7.png", "19.png"],
        &["img-1.png", "img-2.png", "img-10.png"],
        &["9.png", "a.png", "f.png", "10.png", "1a.png"],
        &["0a.bin", "0f.bin", "10.bin", "2a.bin"],
        &["e3.png", "f1.png", "f2.png", "f10.png"],
        &["1.png", "10.png", "100.png"],
    ] {
        let mut files: Vec<PathBuf> = sorted.iter().rev().map(PathBuf::from).collect();
        sort_by_name(&mut files);
        assert_eq!(files, sorted.iter().map(PathBuf::from).collect::<Vec<_>>());
    }
}

#[test]
fn any_bytes_are_a_table_or_none() {
    let mut random = 7u64;
    for _ in 0..20_000 {
        let bytes: Vec<u8> = (0..random % 60)
            .map(|_| {
                random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                b"0123456789.,;# \t\n\"-:eTZax\\/\xff\xfe\0\xc3\xbc"[(random >> 33) as usize % 32]
            })
            .collect();
        random = random.wrapping_add(11);
        let table = Table::parse(&decoded(&bytes));
        let _ = table.stamps().map(|stamps| stamps.remark());
        for name in [None, Some(0), Some(1)] {
            let _ = table
                .times_of(name)
                .map(|times| (table.stamps_at(times).is_ok(), table.is_increasing(times)));
        }
        table.rows.iter().for_each(|row| drop(row.file(1, Path::new("/nowhere"))));
    }
}
