//! The files in which ROS 2 kept its bags before MCAP: SQLite with a table of topics and one of messages, in CDR.
//!
//! Their layout is that of `rosbag2_storage_sqlite3`; several files of one bag are read as one. Messages that were compressed
//! one by one are read too, files that were compressed as a whole are refused with what to do.

use crate::messages::{Content, unpacked};
use crate::topics::Topics;
use anyhow::{Context, Result, bail};
use geometry::limits::MAX_BYTES;
use rusqlite::{Connection, OpenFlags};
use std::path::{Path, PathBuf};

/// A topic of one of the files.
struct Topic {
    name: String,
    kind: String,
    encoding: String,
}

/// Where a message is.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Place {
    /// When it was received, nanoseconds.
    time: u64,
    file: usize,
    id: i64,
    /// Index of its topic.
    topic: usize,
}

struct File {
    path: PathBuf,
    connection: Connection,
}

/// A bag, read so far as to know what is where.
pub struct SqliteBag {
    files: Vec<File>,
    topics: Vec<Topic>,
    /// In order of time.
    places: Vec<Place>,
}

/// A message.
pub struct Message {
    /// The type of its message: `sensor_msgs/msg/Image`.
    pub kind: String,
    /// How it is written: `cdr`.
    pub encoding: String,
    /// When it was received, nanoseconds.
    pub time: u64,
    /// Its bytes.
    pub data: Vec<u8>,
}

impl SqliteBag {
    /// Opens the files of a bag and looks through them.
    ///
    /// # Errors
    /// When one cannot be read or is no bag.
    pub fn open(paths: &[PathBuf]) -> Result<Self> {
        let mut bag = Self { files: Vec::new(), topics: Vec::new(), places: Vec::new() };
        for path in paths {
            bag.add(path)
                .with_context(|| format!("{}: the ROS 2 bag in SQLite cannot be read", path.display()))?;
        }
        bag.places.sort_unstable();
        Ok(bag)
    }

    /// Looks through one more file.
    fn add(&mut self, path: &Path) -> Result<()> {
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let connection = Connection::open_with_flags(path, flags)?;
        let (file, mut ids) = (self.files.len(), Vec::new());
        {
            let mut rows = connection.prepare("SELECT id, name, type, serialization_format FROM topics")?;
            let mut rows = rows.query([])?;
            while let Some(row) = rows.next()? {
                ids.push((row.get::<_, i64>(0)?, self.topics.len()));
                let (name, kind, encoding) = (row.get(1)?, row.get(2)?, row.get(3)?);
                self.topics.push(Topic { name, kind, encoding });
            }
            let mut rows = connection.prepare("SELECT id, topic_id, timestamp FROM messages")?;
            let mut rows = rows.query([])?;
            while let Some(row) = rows.next()? {
                let (id, topic_id, time): (i64, i64, i64) = (row.get(0)?, row.get(1)?, row.get(2)?);
                let known = ids.iter().find(|(known, _)| *known == topic_id);
                let &(_, topic) = known.with_context(|| format!("message {id} has no topic"))?;
                let time = u64::try_from(time).with_context(|| format!("message {id} has no time"))?;
                self.places.push(Place { time, file, id, topic });
            }
        }
        self.files.push(File { path: path.to_owned(), connection });
        Ok(())
    }

    /// The topics.
    pub fn topics(&self) -> Topics {
        let mut topics = Topics::default();
        let mut counts = vec![0; self.topics.len()];
        self.places.iter().for_each(|place| counts[place.topic] += 1);
        for (topic, count) in self.topics.iter().zip(counts) {
            topics.count(&topic.name, &topic.kind, Content::of(&topic.kind, &topic.encoding), count);
        }
        topics.span = self.places.first().zip(self.places.last()).map(|(a, b)| (a.time, b.time));
        topics
    }

    /// The messages of some topics in order of time.
    pub fn messages(mut self, topics: &[String]) -> impl Iterator<Item = Result<Message>> + Send + use<> {
        let wanted: Vec<bool> = self.topics.iter().map(|t| topics.contains(&t.name)).collect();
        let places = std::mem::take(&mut self.places);
        places.into_iter().filter(move |place| wanted[place.topic]).map(move |place| self.message(place))
    }

    fn message(&self, place: Place) -> Result<Message> {
        let (file, topic) = (&self.files[place.file], &self.topics[place.topic]);
        let data = blob(&file.connection, place.id)
            .with_context(|| format!("{}: message {} cannot be read", file.path.display(), place.id))?;
        let (kind, encoding) = (topic.kind.clone(), topic.encoding.clone());
        Ok(Message { kind, encoding, time: place.time, data })
    }
}

/// What a message says.
fn blob(connection: &Connection, id: i64) -> Result<Vec<u8>> {
    let mut query = connection.prepare(
        "SELECT length(data), CASE WHEN length(data) <= ?2 THEN data END FROM messages WHERE id = ?1",
    )?;
    let (length, data): (i64, Option<Vec<u8>>) =
        query.query_row((id, MAX_BYTES as i64), |row| Ok((row.get(0)?, row.get(1)?)))?;
    let Some(data) = data else { bail!("it has {length} bytes, and {MAX_BYTES} are the most that is read") };
    Ok(unpacked(&data)?.into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Writes a bag's file with the messages `(topic, time, data)` of topics 1 and 2.
    fn write(path: &Path, messages: &[(i64, i64, &[u8])]) {
        let connection = Connection::open(path).unwrap();
        connection
            .execute_batch(
                "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
                     serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);
                 CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
                     data BLOB NOT NULL);
                 INSERT INTO topics VALUES (1, '/cam', 'sensor_msgs/msg/Image', 'cdr', ''),
                                           (2, '/imu', 'sensor_msgs/msg/Imu', 'cdr', '');",
            )
            .unwrap();
        for &(topic, time, data) in messages {
            let row = "INSERT INTO messages(topic_id, timestamp, data) VALUES (?1, ?2, ?3)";
            connection.execute(row, (topic, time, data)).unwrap();
        }
    }

    fn reported(paths: &[PathBuf]) -> Vec<(u64, Vec<u8>)> {
        let messages = SqliteBag::open(paths).unwrap().messages(&["/cam".to_owned()]);
        messages.map(|message| message.unwrap()).map(|message| (message.time, message.data)).collect()
    }

    #[test]
    fn messages_of_several_files_come_in_order_of_time() {
        let room = tempfile::tempdir().unwrap();
        let paths = [room.path().join("b_10.db3"), room.path().join("b_9.db3")];
        write(&paths[0], &[(1, 30, b"c"), (2, 31, b"-"), (1, 40, b"d")]);
        write(&paths[1], &[(1, 20, b"b"), (2, 5, b"-"), (1, 10, b"a")]);
        let read: Vec<(u64, Vec<u8>)> = (1..).zip(b"abcd").map(|(i, byte)| (10 * i, vec![*byte])).collect();
        assert_eq!(reported(&paths), read);
        let topics = SqliteBag::open(&paths).unwrap().topics();
        assert_eq!(topics.span, Some((5, 40)));
        assert_eq!(topics.choose(&paths[0], None, "images").unwrap(), ("/cam".to_owned(), 4));
    }

    #[test]
    fn messages_compressed_one_by_one_are_read() {
        let room = tempfile::tempdir().unwrap();
        let path = room.path().join("b.db3");
        let plain = vec![7; 5000];
        let packed = zstd::encode_all(&plain[..], 3).unwrap();
        write(&path, &[(1, 1, &packed), (1, 2, b"plain")]);
        assert_eq!(reported(std::slice::from_ref(&path)), [(1, plain), (2, b"plain".to_vec())]);
        let cut = room.path().join("cut.db3");
        write(&cut, &[(1, 1, &packed[..packed.len() / 2])]);
        let mut messages = SqliteBag::open(&[cut]).unwrap().messages(&["/cam".to_owned()]);
        assert!(messages.next().unwrap().is_err());
    }

    #[test]
    fn what_is_no_bag_is_named() {
        let room = tempfile::tempdir().unwrap();
        let (text, other) = (room.path().join("text.db3"), room.path().join("other.db3"));
        std::fs::write(&text, "SQLite format 3\0 and nothing of the kind").unwrap();
        Connection::open(&other).unwrap().execute_batch("CREATE TABLE people(name TEXT)").unwrap();
        for path in [text, other, room.path().join("none.db3")] {
            let error = SqliteBag::open(std::slice::from_ref(&path)).err().unwrap();
            assert!(error.to_string().contains(path.to_str().unwrap()), "{error:#}");
        }
        let orphan = room.path().join("orphan.db3");
        write(&orphan, &[(3, 1, b"a")]);
        assert!(
            format!("{:#}", SqliteBag::open(&[orphan]).err().unwrap()).contains("message 1 has no topic")
        );
    }
}
