use super::*;
use std::io::Cursor;

const KIND: MessageType = MessageType {
    name: "std_msgs/String",
    md5sum: "00000000000000000000000000000000",
    definition: "string data\n",
};
/// Four bytes 255 and "no record at all".
const BZ2: &[u8] = &[
    66, 90, 104, 57, 49, 65, 89, 38, 83, 89, 49, 227, 144, 195, 0, 0, 10, 81, 128, 192, 0, 64, 0, 46, 5, 148,
    0, 0, 0, 160, 0, 49, 3, 64, 208, 33, 50, 100, 244, 122, 160, 94, 211, 33, 150, 224, 37, 99, 251, 226,
    238, 72, 167, 10, 18, 6, 60, 114, 24, 96,
];
const LIMIT: usize = 1 << 20;

fn bag(messages: u32) -> Vec<u8> {
    let mut writer = BagWriter::create(Cursor::new(Vec::new())).unwrap();
    let (a, b) = (writer.connect("/a", KIND), writer.connect("/b", KIND));
    for i in 0..messages {
        let connection = if i % 3 == 0 { b } else { a };
        writer
            .message(connection, 1_500_000_000_000_000_000 + u64::from(i), &vec![i as u8; 100_000])
            .unwrap();
    }
    writer.finish().unwrap().into_inner()
}

fn read(bytes: &[u8]) -> anyhow::Result<(Vec<Message>, Option<String>)> {
    let mut reader = BagReader::new(Cursor::new(bytes), 8 * LIMIT)?;
    let mut messages = Vec::new();
    for message in reader.by_ref() {
        match message {
            Ok(message) => messages.push(message),
            Err(error) => return Ok((messages, Some(format!("{error:#}")))),
        }
    }
    Ok((messages, None))
}

#[test]
fn what_is_written_is_read() {
    let bytes = bag(100);
    let mut reader = BagReader::new(Cursor::new(&bytes), 8 * LIMIT).unwrap();
    let content = reader.content().unwrap();
    let counts: Vec<_> =
        content.connections.iter().map(|(c, n)| (c.topic.as_str(), c.kind.as_str(), *n)).collect();
    assert_eq!(counts, [("/a", "std_msgs/String", 66), ("/b", "std_msgs/String", 34)]);
    assert_eq!(content.span, Some((1_500_000_000_000_000_000, 1_500_000_000_000_000_099)));
    let messages: Vec<Message> = reader.map(Result::unwrap).collect();
    assert_eq!(messages.len(), 100);
    assert!(messages.iter().enumerate().all(|(i, m)| m.data == vec![i as u8; 100_000]
        && m.time == 1_500_000_000_000_000_000 + i as u64
        && m.connection.topic == if i % 3 == 0 { "/b" } else { "/a" }));
}

#[test]
fn a_bag_cut_anywhere_gives_back_its_whole_messages() {
    let bytes = bag(100);
    // Up to where the index begins.
    for length in (0..bytes.len() - 1500).step_by(bytes.len() / 61) {
        // A message takes some 100 bytes more than it holds.
        let whole = (length / 100_200).saturating_sub(1);
        let Ok((messages, problem)) = read(&bytes[..length]) else {
            assert!(length < 5000, "{length}");
            continue;
        };
        assert!(
            messages.len() >= whole && problem.is_some(),
            "{} messages of {length} bytes",
            messages.len()
        );
        assert!(BagReader::new(Cursor::new(&bytes[..length]), LIMIT).unwrap().content().is_none());
    }
}

#[test]
fn damaged_bytes_are_read_or_refused() {
    let whole = bag(3);
    let mut random = geometry::Random::new(4);
    for _ in 0..400 {
        let mut bytes = whole.clone();
        for _ in 0..4 {
            // Where the lengths and fields lie: the head, and behind the messages.
            let at = random.index(9000);
            let at = if at < 4500 { at } else { bytes.len() - (at - 4499) };
            bytes[at] = random.bits() as u8;
        }
        if let Ok(mut reader) = BagReader::new(Cursor::new(&bytes), LIMIT) {
            let _ = reader.content();
            let _ = reader.count();
        }
    }
}

/// A bag of one chunk, packed by others.
fn packed(compression: &str, size: usize, data: &[u8]) -> Vec<u8> {
    let plain = bag(0);
    let field = |text: &[u8]| [&(text.len() as u32).to_le_bytes(), text].concat();
    let size = [&b"size="[..], &(size as u32).to_le_bytes()].concat();
    let header =
        [field(b"op=\x05"), field(format!("compression={compression}").as_bytes()), field(&size)].concat();
    let mut header_part = plain[..MAGIC.len() + 4096].to_vec();
    // As a recorder that was killed leaves it.
    let at = header_part.windows(10).position(|w| w == b"index_pos=").unwrap() + 10;
    header_part[at..at + 8].fill(0);
    [header_part, field(&header), field(data)].concat()
}

fn chunk() -> Vec<u8> {
    let bytes = bag(2);
    let start = bytes.windows(5).position(|w| w == b"size=").unwrap() + 5;
    let size = u32::from_le_bytes(bytes[start..start + 4].try_into().unwrap()) as usize;
    bytes[start + 8..start + 8 + size].to_vec()
}

#[test]
fn packed_chunks_are_unpacked() {
    use std::io::Write;
    let chunk = chunk();
    let mut encoder = lz4::EncoderBuilder::new().build(Vec::new()).unwrap();
    encoder.write_all(&chunk).unwrap();
    let (lz4, done) = encoder.finish();
    done.unwrap();
    let (messages, problem) = read(&packed("lz4", chunk.len(), &lz4)).unwrap();
    assert_eq!((messages.len(), messages[1].data.len()), (2, 100_000));
    assert!(problem.unwrap().contains("did not end it"));
    assert!(read(&packed("lz4", chunk.len(), &lz4[..lz4.len() / 2])).unwrap().1.is_some());
    assert!(read(&packed("zip", 3, b"abc")).unwrap().1.unwrap().contains("'zip'"));
    assert!(read(&packed("lz4", usize::MAX, &lz4)).unwrap().1.unwrap().contains("claims"));
    // `bzip2` of 20 bytes that are no records: unpacked, then refused.
    let (_, problem) = read(&packed("bz2", 20, BZ2)).unwrap();
    assert!(problem.unwrap().contains("a chunk ends early"));
    assert!(read(&packed("bz2", 20, &BZ2[..20])).unwrap().1.unwrap().contains("unpack"));
}
