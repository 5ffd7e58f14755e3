//! Writing the container.

use super::read::{ReadError, Recording};
use super::{RECIPE_ATTACHMENT, RUN_METADATA, Record, STATION_ATTACHMENT, Topic, viewer};
use crate::controller::Header;
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, Compression, McapError, WriteOptions};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{Seek, Write};

/// Writes one recording: metadata and attachments first, then records as they come.
pub struct Writer<W: Write + Seek> {
    mcap: mcap::Writer<W>,
    /// The channel of each topic, in the order of [`Topic::ALL`].
    channel_ids: Vec<u16>,
    start_unix_ns: u64,
    sequence: u32,
    record_count: u64,
    flushed_count: u64,
}

impl<W: Write + Seek> Writer<W> {
    /// Begins a recording that a killed process leaves readable: no chunks, every record written as it comes.
    pub fn begin(
        out: W,
        header: &Header,
        start_unix_ns: u64,
        recipe_text: &str,
        station_text: &str,
    ) -> Result<Self, McapError> {
        let options = options().use_chunks(false).compression(None);
        Self::open(out, options, header, start_unix_ns, recipe_text, station_text)
    }

    fn open(
        out: W,
        options: WriteOptions,
        header: &Header,
        start_unix_ns: u64,
        recipe_text: &str,
        station_text: &str,
    ) -> Result<Self, McapError> {
        let mut mcap = options.create(out)?;
        mcap.write_metadata(&Metadata {
            name: RUN_METADATA.into(),
            metadata: BTreeMap::from([
                ("start_unix_ns".to_owned(), start_unix_ns.to_string()),
                (
                    "header".to_owned(),
                    serde_json::to_string(header).expect("a header always has a JSON text"),
                ),
            ]),
        })?;
        for (name, text) in [(RECIPE_ATTACHMENT, recipe_text), (STATION_ATTACHMENT, station_text)] {
            mcap.attach(&Attachment {
                log_time: start_unix_ns,
                create_time: start_unix_ns,
                name: name.into(),
                media_type: "application/toml".into(),
                data: Cow::Borrowed(text.as_bytes()),
            })?;
        }
        let mut channel_ids = Vec::new();
        for topic in Topic::ALL {
            let schema_id = match schema(topic) {
                Some(schema) => mcap.add_schema(&schema.name, &schema.encoding, &schema.data)?,
                None => 0,
            };
            channel_ids.push(mcap.add_channel(schema_id, topic.name(), message_encoding(topic), &BTreeMap::new())?);
        }
        Ok(Self {
            mcap,
            channel_ids,
            start_unix_ns,
            sequence: 0,
            record_count: 0,
            flushed_count: 0,
        })
    }

    /// Writes one record.
    pub fn write(&mut self, record: &Record) -> Result<(), McapError> {
        let index = Topic::ALL
            .into_iter()
            .position(|topic| topic == record.topic)
            .expect("ALL holds every topic");
        let log_time = self.start_unix_ns + record.stamp.ns;
        let header = MessageHeader {
            channel_id: self.channel_ids[index],
            sequence: self.sequence,
            log_time,
            publish_time: log_time,
        };
        self.sequence = self.sequence.wrapping_add(1);
        self.mcap.write_to_known_channel(&header, &record.payload)?;
        self.record_count += 1;
        Ok(())
    }

    /// Hands everything written so far to the operating system.
    pub fn flush(&mut self) -> Result<(), McapError> {
        self.mcap.flush()?;
        self.flushed_count = self.record_count;
        Ok(())
    }

    /// How many records have been handed to the operating system.
    pub fn flushed_count(&self) -> u64 {
        self.flushed_count
    }

    /// Leaves the recording as it is, without an end: what a writer that has failed still holds is not written.
    pub fn abandon(self) -> W {
        self.mcap.into_inner()
    }

    /// Writes metadata and attachments of others as they are.
    pub(super) fn keep(&mut self, metadata: &[Metadata], attachments: &[Attachment<'_>]) -> Result<(), McapError> {
        for some in metadata {
            self.mcap.write_metadata(some)?;
        }
        for some in attachments {
            self.mcap.attach(some)?;
        }
        Ok(())
    }

    /// Ends the recording and hands the underlying writer back.
    pub fn finish(mut self) -> Result<W, McapError> {
        self.mcap.finish()?;
        Ok(self.mcap.into_inner())
    }
}

/// Writes a recording anew with compressed chunks and an index.
pub fn pack<W: Write + Seek>(recording: &Recording<'_>, out: W) -> Result<W, ReadError> {
    let options = options()
        .compression(Some(Compression::Zstd))
        .compression_threads(0)
        .compression_level(1);
    let mut writer = Writer::open(
        out,
        options,
        recording.header(),
        recording.start_unix_ns(),
        recording.recipe_text(),
        recording.station_text(),
    )?;
    let (metadata, attachments) = recording.extras()?;
    writer.keep(&metadata, &attachments)?;
    for record in recording.whole_records()? {
        writer.write(&record?)?;
    }
    Ok(writer.finish()?)
}

fn options() -> WriteOptions {
    WriteOptions::new().library(concat!("bladescan ", env!("CARGO_PKG_VERSION")))
}

fn schema(topic: Topic) -> Option<foxglove::Schema> {
    match topic {
        Topic::ViewCloud | Topic::Model => viewer::cloud_schema(),
        Topic::Transform => viewer::transform_schema(),
        Topic::Log => viewer::log_schema(),
        Topic::Input | Topic::Output | Topic::Event => Some(foxglove::Schema::new(
            format!("bladescan{}", topic.name().replace('/', ".")),
            "jsonschema",
            br#"{"type":"object"}"#.as_slice(),
        )),
        Topic::RobotReceived | Topic::RobotSent | Topic::CameraReceived | Topic::CameraSent => None,
    }
}

fn message_encoding(topic: Topic) -> &'static str {
    match topic {
        Topic::ViewCloud | Topic::Model | Topic::Transform | Topic::Log => "protobuf",
        Topic::Input | Topic::Output | Topic::Event => "json",
        Topic::RobotReceived | Topic::RobotSent => "hses",
        Topic::CameraReceived | Topic::CameraSent => "a3dp",
    }
}
