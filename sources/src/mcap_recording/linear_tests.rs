use super::*;
use mcap::{Compression, WriteOptions, Writer};
use std::collections::BTreeMap;
use std::io::Cursor;

/// A file of this many messages on two topics, in chunks of about ten.
fn file(count: u32, compression: Option<Compression>) -> Vec<u8> {
    let mut bytes = Vec::new();
    let options = WriteOptions::new().compression(compression).chunk_size(Some(10_000));
    let mut writer: Writer<_> = options.create(Cursor::new(&mut bytes)).unwrap();
    let schema = writer.add_schema("kind", "jsonschema", b"{}").unwrap();
    let channels =
        ["/a", "/b"].map(|topic| writer.add_channel(schema, topic, "json", &BTreeMap::new()).unwrap());
    let mut random = geometry::Random::new(5);
    for number in 0..count {
        let mut data = vec![0; 1000];
        data[..500].iter_mut().for_each(|byte| *byte = random.bits() as u8);
        let (channel_id, time) = (channels[number as usize % 2], u64::from(number));
        let header =
            mcap::records::MessageHeader { channel_id, sequence: number, log_time: time, publish_time: time };
        writer.write_to_known_channel(&header, &data).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    bytes
}

/// The numbers of the messages, and how many damages there are.
fn read(bytes: &[u8]) -> (Vec<u32>, usize) {
    let input = Input::Memory("memory".into(), Arc::from(bytes));
    let summary = mcap::Summary::read(bytes).ok().flatten();
    let (mut numbers, mut damages) = (Vec::new(), 0);
    for message in Linear::open(&input, summary.as_ref()).unwrap() {
        match message {
            Ok(message) => numbers.push(message.sequence),
            Err(_) => damages += 1,
        }
    }
    assert!(numbers.windows(2).all(|pair| pair[0] < pair[1]), "{numbers:?}");
    (numbers, damages)
}

fn forms() -> [Option<Compression>; 3] {
    [None, Some(Compression::Zstd), Some(Compression::Lz4)]
}

#[test]
fn a_whole_file_is_read_as_by_the_crate() {
    for form in forms() {
        let bytes = file(100, form);
        let expected: Vec<_> = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap).collect();
        let input = Input::Memory("memory".into(), Arc::from(&bytes[..]));
        let found: Vec<_> = Linear::open(&input, None).unwrap().map(Result::unwrap).collect();
        assert_eq!(found, expected);
    }
}

#[test]
fn a_damaged_chunk_costs_what_it_holds() {
    for form in forms() {
        let whole = file(100, form);
        let summary = mcap::Summary::read(&whole).unwrap().unwrap();
        let chunk = &summary.chunk_indexes[4];
        // In the middle of its records, in its length, and in the length of its first record.
        for (at, xor) in [(chunk.chunk_length / 2, 0x55), (2, 0x7f), (4, 0x01), (0, 0xff)] {
            let mut bytes = whole.clone();
            bytes[(chunk.chunk_start_offset + at) as usize] ^= xor;
            let (numbers, damages) = read(&bytes);
            assert!(numbers.len() >= 88 && damages >= 1, "{form:?} at {at}: {} and {damages}", numbers.len());
            assert_eq!((numbers[0], numbers.last()), (0, Some(&99)), "{form:?} at {at}");
        }
    }
}

#[test]
fn two_damages_are_reported_and_what_lies_between_is_read() {
    let mut bytes = file(100, None);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    for place in [2, 7] {
        let start = summary.chunk_indexes[place].chunk_start_offset as usize;
        bytes[start + 1..start + 60].fill(0xee);
    }
    let (numbers, damages) = read(&bytes);
    assert!(damages >= 2);
    assert!((75..=82).contains(&numbers.len()), "{}", numbers.len());
}

#[test]
fn a_flipped_bit_that_only_the_checksum_sees_is_reported() {
    let mut bytes = file(20, None);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let chunk = &summary.chunk_indexes[0];
    let inside = (chunk.chunk_start_offset + chunk.chunk_length - 100) as usize;
    bytes[inside] ^= 1;
    assert_eq!(read(&bytes).1, 1);
    assert_eq!(read(&bytes).0.len(), 20, "the message is there, and said to be doubtful");
}

#[test]
fn a_file_that_is_cut_is_read_up_to_there() {
    for form in forms() {
        let bytes = file(60, form);
        for length in (0..bytes.len()).step_by(377) {
            let (numbers, damages) = read(&bytes[..length]);
            assert_eq!(damages, 1, "{form:?} {length}");
            let whole = if form.is_none() {
                (length / 1040).saturating_sub(2)
            } else {
                (length / 11_000).saturating_sub(1) * 9
            };
            assert!(numbers.len() >= whole.min(60), "{form:?} {length}: {}", numbers.len());
        }
    }
}

#[test]
fn any_damage_is_read_or_reported() {
    let mut random = geometry::Random::new(9);
    for form in forms() {
        let whole = file(40, form);
        for _ in 0..500 {
            let mut bytes = whole.clone();
            for _ in 0..1 + random.index(6) {
                let at = random.index(bytes.len());
                bytes[at] = random.bits() as u8;
            }
            read_any(&bytes);
        }
    }
    read_any(b"\x89MCAP0\r\n");
    read_any(b"");
}

fn read_any(bytes: &[u8]) {
    let input = Input::Memory("memory".into(), Arc::from(bytes));
    let summary = mcap::Summary::read(bytes).ok().flatten();
    assert!(Linear::open(&input, summary.as_ref()).unwrap().count() < 1000);
}
