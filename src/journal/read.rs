//! Reading a recording back.

use super::{RECIPE_ATTACHMENT, RUN_METADATA, Record, STATION_ATTACHMENT, Topic, Writer};
use crate::controller::Header;
use crate::stamp::Stamp;
use mcap::read::{LinearReader, Options};
use mcap::records::{Metadata, Record as RawRecord};
use mcap::{Attachment, McapError, MessageStream};
use std::borrow::Cow;
use std::io::{Seek, Write};
use thiserror::Error;

/// A recording in memory.
#[derive(Debug)]
pub struct Recording<'a> {
    bytes: &'a [u8],
    header: Header,
    start_unix_ns: u64,
    recipe_text: String,
    station_text: String,
}

/// Why a file is not a recording of ours.
#[derive(Debug, Error)]
pub enum ReadError {
    /// Not an MCAP file, or a damaged one.
    #[error("not a readable MCAP file: {0}")]
    Mcap(#[from] McapError),
    /// An MCAP file, but not of a bladescan run.
    #[error("an MCAP file without {0}: not a recording of bladescan")]
    Missing(&'static str),
    /// A topic of another program.
    #[error("topic {0} is not one of bladescan's")]
    Topic(String),
}

impl<'a> Recording<'a> {
    /// Reads what describes the run. The file may lack its end (a killed process).
    pub fn open(bytes: &'a [u8]) -> Result<Self, ReadError> {
        let (mut run, mut recipe_text, mut station_text) = (None, None, None);
        for record in LinearReader::new_with_options(bytes, Options::IgnoreEndMagic.into())? {
            match record {
                Ok(RawRecord::Metadata(metadata)) if metadata.name == RUN_METADATA => run = Some(metadata.metadata),
                Ok(RawRecord::Attachment { header, data, .. }) => {
                    let text = Some(String::from_utf8_lossy(&data).into_owned());
                    match header.name.as_str() {
                        RECIPE_ATTACHMENT => recipe_text = text,
                        STATION_ATTACHMENT => station_text = text,
                        _ => {}
                    }
                }
                Ok(_) => {}
                Err(error) if run.is_none() || station_text.is_none() => return Err(error.into()),
                Err(_) => break,
            }
            if run.is_some() && recipe_text.is_some() && station_text.is_some() {
                break;
            }
        }
        let run = run.ok_or(ReadError::Missing("the metadata of a run"))?;
        let header = run.get("header").and_then(|text| serde_json::from_str(text).ok());
        let start = run.get("start_unix_ns").and_then(|text| text.parse().ok());
        Ok(Self {
            bytes,
            header: header.ok_or(ReadError::Missing("a readable run header"))?,
            start_unix_ns: start.ok_or(ReadError::Missing("the time the run began"))?,
            recipe_text: recipe_text.ok_or(ReadError::Missing("its recipe"))?,
            station_text: station_text.ok_or(ReadError::Missing("its station"))?,
        })
    }

    /// What names the run.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// When the run began, nanoseconds since 1970 UTC.
    pub fn start_unix_ns(&self) -> u64 {
        self.start_unix_ns
    }

    /// The recipe, word for word.
    pub fn recipe_text(&self) -> &str {
        &self.recipe_text
    }

    /// The station, word for word.
    pub fn station_text(&self) -> &str {
        &self.station_text
    }

    /// Whether its end was written. The recording of a killed process, or of one that still runs, lacks it.
    pub fn is_closed(&self) -> bool {
        self.bytes.ends_with(mcap::MAGIC)
    }

    /// A recording that begins with everything that is whole in this one, and `more`, and can go on.
    pub fn copied<W: Write + Seek>(&self, out: W, more: &[Record]) -> Result<Writer<W>, ReadError> {
        let mut writer = Writer::begin(
            out,
            &self.header,
            self.start_unix_ns,
            &self.recipe_text,
            &self.station_text,
        )?;
        let (metadata, attachments) = self.extras()?;
        writer.keep(&metadata, &attachments)?;
        for record in self.whole_records()? {
            writer.write(&record?)?;
        }
        for record in more {
            writer.write(record)?;
        }
        writer.flush()?;
        Ok(writer)
    }

    /// The records in the order in which they were written. Of a recording without its end those before the first that is
    /// not whole; in one with its end such a record is damage, and an error.
    pub fn whole_records(&self) -> Result<impl Iterator<Item = Result<Record, ReadError>> + use<'a>, ReadError> {
        let is_closed = self.is_closed();
        let is_kept = move |record: &Result<Record, ReadError>| is_closed || !matches!(record, Err(ReadError::Mcap(_)));
        Ok(self.records()?.take_while(is_kept))
    }

    /// Metadata and attachments that others have put in.
    pub(super) fn extras(&self) -> Result<(Vec<Metadata>, Vec<Attachment<'static>>), ReadError> {
        let (mut metadata, mut attachments) = (Vec::new(), Vec::new());
        for record in LinearReader::new_with_options(self.bytes, Options::IgnoreEndMagic.into())? {
            match record {
                Ok(RawRecord::Metadata(found)) if found.name != RUN_METADATA => metadata.push(found),
                Ok(RawRecord::Attachment { header, data, .. })
                    if header.name != RECIPE_ATTACHMENT && header.name != STATION_ATTACHMENT =>
                {
                    attachments.push(Attachment {
                        log_time: header.log_time,
                        create_time: header.create_time,
                        name: header.name,
                        media_type: header.media_type,
                        data: Cow::Owned(data.into_owned()),
                    });
                }
                Ok(_) => {}
                // A killed process leaves the last record torn.
                Err(_) => break,
            }
        }
        Ok((metadata, attachments))
    }

    /// The records in the order in which they were written.
    pub fn records(&self) -> Result<impl Iterator<Item = Result<Record, ReadError>> + use<'a>, ReadError> {
        let start_unix_ns = self.start_unix_ns;
        let stream = MessageStream::new_with_options(self.bytes, Options::IgnoreEndMagic.into())?;
        Ok(stream.map(move |message| {
            let message = message?;
            let topic = Topic::from_name(&message.channel.topic)
                .ok_or_else(|| ReadError::Topic(message.channel.topic.clone()))?;
            Ok(Record {
                topic,
                stamp: Stamp {
                    ns: message.log_time.saturating_sub(start_unix_ns),
                },
                payload: message.data.into_owned(),
            })
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Writer, pack};
    use super::*;
    use crate::seed::Seed;
    use std::io::Cursor;

    fn header() -> Header {
        Header {
            version: "0".into(),
            target: "t".into(),
            seed: Seed(7),
            run_id: 11,
            recipe: "r".into(),
            station: "s".into(),
            view_count: Some(3),
            ..Header::default()
        }
    }

    fn records() -> Vec<Record> {
        Topic::ALL
            .into_iter()
            .enumerate()
            .map(|(index, topic)| Record {
                topic,
                stamp: Stamp { ns: index as u64 },
                payload: vec![index as u8; index],
            })
            .collect()
    }

    fn written() -> Vec<u8> {
        let mut writer = Writer::begin(Cursor::new(Vec::new()), &header(), 1_000, "recipe", "station").unwrap();
        for record in records() {
            writer.write(&record).unwrap();
        }
        writer.finish().unwrap().into_inner()
    }

    fn read(bytes: &[u8]) -> Vec<Record> {
        let recording = Recording::open(bytes).unwrap();
        assert_eq!(recording.header(), &header());
        assert_eq!(
            (recording.recipe_text(), recording.station_text()),
            ("recipe", "station")
        );
        recording.records().unwrap().collect::<Result<_, _>>().unwrap()
    }

    #[test]
    fn a_recording_reads_back_and_packing_changes_none_of_its_records() {
        let plain = written();
        assert_eq!(read(&plain), records());
        let packed = pack(&Recording::open(&plain).unwrap(), Cursor::new(Vec::new()))
            .unwrap()
            .into_inner();
        assert_eq!(read(&packed), records());
        assert!(mcap::Summary::read(&packed).unwrap().unwrap().stats.is_some());
    }

    #[test]
    fn packing_keeps_what_others_have_attached() {
        let mut writer = Writer::begin(Cursor::new(Vec::new()), &header(), 1_000, "recipe", "station").unwrap();
        let note = Metadata {
            name: "note".into(),
            metadata: [("by".to_owned(), "somebody".to_owned())].into(),
        };
        let picture = Attachment {
            log_time: 5,
            create_time: 6,
            name: "picture.png".into(),
            media_type: "image/png".into(),
            data: Cow::Borrowed(&[1, 2, 3]),
        };
        writer
            .keep(std::slice::from_ref(&note), std::slice::from_ref(&picture))
            .unwrap();
        let plain = writer.finish().unwrap().into_inner();
        let packed = pack(&Recording::open(&plain).unwrap(), Cursor::new(Vec::new()))
            .unwrap()
            .into_inner();
        let recording = Recording::open(&packed).unwrap();
        assert_eq!(recording.header(), &header());
        assert_eq!(recording.extras().unwrap(), (vec![note], vec![picture]));
    }

    #[test]
    fn the_records_before_a_cut_are_still_there() {
        let plain = written();
        let cut = &plain[..plain.len() / 2];
        let recording = Recording::open(cut).unwrap();
        let found: Vec<Record> = recording.whole_records().unwrap().map(Result::unwrap).collect();
        assert!(records().starts_with(&found));
    }

    #[test]
    fn other_files_are_refused_with_a_reason() {
        assert!(matches!(Recording::open(b"not mcap"), Err(ReadError::Mcap(_))));
        let foreign = mcap::Writer::new(Cursor::new(Vec::new())).unwrap();
        let mut foreign = foreign;
        foreign.finish().unwrap();
        let bytes = foreign.into_inner().into_inner();
        assert!(matches!(Recording::open(&bytes), Err(ReadError::Missing(_))));
    }
}
