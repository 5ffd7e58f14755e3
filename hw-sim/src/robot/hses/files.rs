//! The file port: lists, transfers either way, deletions. One transfer at a time.
//!
//! The server repeats nothing by itself. A client that misses a block says its last word again: a repeated request or
//! acknowledgement brings the block that is due once more, a repeated block is acknowledged again and not taken twice.

use core::net::SocketAddr;

use crate::fault::Fault;
use crate::robot::controller::Controller;
use crate::robot::files::FILE_BYTES_MAX;
use crate::robot::hses::{Answer, DATA_BYTES_MAX, LAST_BLOCK, Refusal, Request};
use crate::robot::refused::Refused;

/// State of the file port.
#[derive(Clone, Debug, Default)]
pub(in crate::robot) struct FileLink {
    transfer: Option<Transfer>,
    /// Requests and blocks of the transfer that has ended: repeats of them are no violations.
    ended: Option<Ended>,
    has_stalled: bool,
}

/// A transfer under way.
#[derive(Clone, Debug)]
struct Transfer {
    peer: SocketAddr,
    request: Request,
    way: Way,
    deadline_ns: u64,
}

#[derive(Clone, Debug)]
enum Way {
    /// Blocks of these bytes, `block` not acknowledged yet.
    ToClient { bytes: Vec<u8>, block: u32 },
    /// Bytes so far; `block` is the next.
    ToController { bytes: Vec<u8>, block: u32 },
}

#[derive(Clone, Debug)]
struct Ended {
    peer: SocketAddr,
    service: u8,
    block: u32,
    answer: Option<Vec<u8>>,
}

impl Controller {
    /// Answer to a well-formed datagram of the file port, if it gets one.
    pub(in crate::robot) fn reply_file(&mut self, now_ns: u64, from: SocketAddr, request: &Request) -> Option<Vec<u8>> {
        if request.is_continuation {
            return self.continue_transfer(now_ns, from, request);
        }
        let repeats = |transfer: &Transfer| transfer.peer == from && transfer.request == *request;
        if self.file_link.transfer.as_ref().is_some_and(repeats) {
            return self.due_block(now_ns);
        }
        if self
            .file_link
            .transfer
            .as_ref()
            .is_some_and(|transfer| transfer.peer != from)
        {
            return Some(self.refuse(request, Refused::FILE_IN_USE.into()));
        }
        self.file_link.transfer = None;
        match self.begin(now_ns, from, request) {
            Ok(answer) => answer,
            Err(refusal) => Some(self.refuse(request, refusal)),
        }
    }

    /// When a transfer whose client is silent is dropped.
    pub(in crate::robot) fn file_deadline_ns(&self) -> Option<u64> {
        self.file_link.transfer.as_ref().map(|transfer| transfer.deadline_ns)
    }

    /// Drops the transfer and tells its client.
    pub(in crate::robot) fn drop_transfer(&mut self) -> Option<(SocketAddr, Vec<u8>)> {
        let transfer = self.file_link.transfer.take()?;
        let refusal = Refused::FILE_STALLED.into();
        Some((transfer.peer, self.refuse(&transfer.request, refusal)))
    }

    /// Forgets the transfer, as a loss of power does.
    pub(in crate::robot) fn forget_transfer(&mut self) {
        self.file_link.transfer = None;
        self.file_link.ended = None;
    }

    fn begin(&mut self, now_ns: u64, from: SocketAddr, request: &Request) -> Result<Option<Vec<u8>>, Refusal> {
        if (request.command, request.instance, request.attribute) != (0, 0, 0) {
            return Err(Refusal::UndefinedCommand);
        }
        let is_known = matches!(
            request.service,
            SERVICE_DELETE | SERVICE_LOAD | SERVICE_SAVE | SERVICE_LIST
        );
        if !is_known {
            return Err(Refusal::UndefinedCommand);
        }
        if request.data.is_empty() {
            return Err(Refused(FRAME_WITHOUT_DATA).into());
        }
        let name = core::str::from_utf8(&request.data).map_err(|_| Refused::FILE_PATH)?;
        let way = match request.service {
            SERVICE_DELETE => {
                self.delete_file(now_ns, name)?;
                return Ok(Some(request.done(&[])));
            }
            SERVICE_LIST => {
                let names = self.file_names(now_ns, name)?;
                let lines: String = names.into_iter().map(|name| name + "\r\n").collect();
                to_client(lines.into_bytes())?
            }
            SERVICE_SAVE => to_client(self.file(now_ns, name)?)?,
            _ => {
                self.check_can_put(name)?;
                Way::ToController {
                    bytes: Vec::new(),
                    block: 1,
                }
            }
        };
        self.file_link.transfer = Some(Transfer {
            peer: from,
            request: request.clone(),
            way,
            deadline_ns: now_ns,
        });
        Ok(self.due_block(now_ns))
    }

    /// What the client of the transfer waits for: the block that is not acknowledged, or leave to send.
    fn due_block(&mut self, now_ns: u64) -> Option<Vec<u8>> {
        let stall_ns = (self.settings.options.file_stall_s * 1e9) as u64;
        let transfer = self.file_link.transfer.as_mut()?;
        transfer.deadline_ns = now_ns + stall_ns;
        let (answer, number) = match &transfer.way {
            Way::ToClient { bytes, block } => {
                let data = block_of(bytes, *block);
                let answer = Answer {
                    block: flagged(bytes, *block),
                    ..transfer.request.answer()
                };
                (answer.bytes(0, None, data), *block)
            }
            Way::ToController { .. } => (transfer.request.done(&[]), 0),
        };
        self.unless_stalled(number, answer)
    }

    fn continue_transfer(&mut self, now_ns: u64, from: SocketAddr, request: &Request) -> Option<Vec<u8>> {
        let Some(transfer) = self
            .file_link
            .transfer
            .as_mut()
            .filter(|transfer| transfer.peer == from)
        else {
            return self.repeat_of_ended(from, request);
        };
        // Clients repeat the service as it is or, as an answer would, with its highest bit.
        if request.service & 0x7F != transfer.request.service {
            self.violation(format!("hses from {from}: a block of another transfer"));
            return Some(self.refuse(request, Refused(FRAME_ACK).into()));
        }
        let number = request.block & !LAST_BLOCK;
        match &mut transfer.way {
            Way::ToClient { bytes, block } => {
                // One client strips the mark of the last block from its acknowledgement: both are taken.
                if !request.data.is_empty() {
                    self.violation(format!("hses from {from}: an acknowledgement with data"));
                    return None;
                }
                if number == *block && is_last(bytes, number) {
                    self.end_transfer(request, None);
                    return None;
                }
                if number == *block {
                    *block += 1;
                    return self.due_block(now_ns);
                }
                if number + 1 == *block {
                    return self.due_block(now_ns);
                }
                if number > *block {
                    self.violation(format!(
                        "hses from {from}: block {number} is acknowledged that was never sent"
                    ));
                }
                None
            }
            Way::ToController { bytes, block } => {
                if number + 1 == *block {
                    return Some(accepted(&transfer.request, request.block));
                }
                if number != *block {
                    self.violation(format!("hses from {from}: block {number} is out of turn"));
                    return Some(self.refuse_transfer(request, Refused(FRAME_BLOCK)));
                }
                if bytes.len() + request.data.len() > FILE_BYTES_MAX {
                    return Some(self.refuse_transfer(request, Refused::JOB_MEMORY));
                }
                bytes.extend_from_slice(&request.data);
                if request.block & LAST_BLOCK != 0 {
                    let bytes = core::mem::take(bytes);
                    return self.take_file(now_ns, from, request, &bytes);
                }
                *block += 1;
                let stall_ns = (self.settings.options.file_stall_s * 1e9) as u64;
                transfer.deadline_ns = now_ns + stall_ns;
                let answer = accepted(&transfer.request, request.block);
                self.unless_stalled(number, answer)
            }
        }
    }

    /// The last block has come: the file is stored, or refused as a whole.
    fn take_file(&mut self, now_ns: u64, from: SocketAddr, last: &Request, bytes: &[u8]) -> Option<Vec<u8>> {
        let request = self.file_link.transfer.as_ref()?.request.clone();
        let name = String::from_utf8_lossy(&request.data).into_owned();
        let answer = match self.put_file(now_ns, &name, bytes) {
            Ok(()) => accepted(&request, last.block),
            Err(error) => {
                self.violation(format!("hses from {from}: file {name}: {error}"));
                let block = last.block;
                self.refuse(&Request { block, ..request }, error.refused.into())
            }
        };
        self.end_transfer(last, Some(answer.clone()));
        self.unless_stalled(last.block & !LAST_BLOCK, answer)
    }

    fn end_transfer(&mut self, last: &Request, answer: Option<Vec<u8>>) {
        if let Some(transfer) = self.file_link.transfer.take() {
            self.file_link.ended = Some(Ended {
                peer: transfer.peer,
                service: transfer.request.service,
                block: last.block & !LAST_BLOCK,
                answer,
            });
        }
    }

    fn repeat_of_ended(&mut self, from: SocketAddr, request: &Request) -> Option<Vec<u8>> {
        let number = request.block & !LAST_BLOCK;
        let is_repeat =
            |ended: &&Ended| (ended.peer, ended.service) == (from, request.service & 0x7F) && number <= ended.block;
        match self.file_link.ended.as_ref().filter(is_repeat) {
            Some(ended) => ended.answer.clone().filter(|_| number == ended.block),
            None => {
                self.violation(format!("hses from {from}: a block of no transfer"));
                Some(self.refuse(request, Refused(FRAME_ACK).into()))
            }
        }
    }

    fn refuse_transfer(&mut self, request: &Request, refused: Refused) -> Vec<u8> {
        self.file_link.transfer = None;
        self.refuse(request, refused.into())
    }

    pub(in crate::robot) fn refuse(&self, request: &Request, refusal: Refusal) -> Vec<u8> {
        request.refused(refusal, self.settings.options.errors_in_added_status)
    }

    /// The answer, but once none at the block of the fault.
    fn unless_stalled(&mut self, number: u32, answer: Vec<u8>) -> Option<Vec<u8>> {
        let stalls = self.settings.faults.contains(&Fault::FileStall { block: number });
        if stalls && !self.file_link.has_stalled {
            self.file_link.has_stalled = true;
            return None;
        }
        Some(answer)
    }
}

fn to_client(bytes: Vec<u8>) -> Result<Way, Refused> {
    if bytes.is_empty() {
        return Err(Refused::FILE_EMPTY);
    }
    Ok(Way::ToClient { bytes, block: 1 })
}

/// Answer to a block of a client. No source says which number it carries; here that of the block.
fn accepted(request: &Request, block: u32) -> Vec<u8> {
    let answer = Answer {
        block,
        ..request.answer()
    };
    answer.bytes(0, None, &[])
}

fn block_of(bytes: &[u8], block: u32) -> &[u8] {
    bytes.chunks(DATA_BYTES_MAX).nth(block as usize - 1).unwrap_or_default()
}

fn is_last(bytes: &[u8], block: u32) -> bool {
    block as usize * DATA_BYTES_MAX >= bytes.len()
}

fn flagged(bytes: &[u8], block: u32) -> u32 {
    if is_last(bytes, block) {
        block | LAST_BLOCK
    } else {
        block
    }
}

/// Delete a file.
pub const SERVICE_DELETE: u8 = 0x09;
/// Client to controller.
pub const SERVICE_LOAD: u8 = 0x15;
/// Controller to client.
pub const SERVICE_SAVE: u8 = 0x16;
/// Names of files.
pub const SERVICE_LIST: u8 = 0x32;
const FRAME_WITHOUT_DATA: u16 = 0xE49D;
const FRAME_BLOCK: u16 = 0xE4A1;
const FRAME_ACK: u16 = 0xE4A2;

#[cfg(test)]
#[path = "files_tests.rs"]
mod tests;
