//! Commands 0x300 to 0x30C: several variables, registers or signal bytes in a row.

use crate::checks::refuse_first;
use crate::robot::controller::Controller;
use crate::robot::hses::commands::Reply;
use crate::robot::hses::records::{no_instance, value_fields, value_of};
use crate::robot::hses::{Refusal, Request, SERVICE_READ_PLURAL, SERVICE_WRITE_PLURAL, u16_at};
use crate::robot::io::NETWORK_IN;
use crate::robot::refused::Refused;
use crate::robot::variables::{REGISTER_WRITABLE_COUNT, check};

impl Controller {
    pub(super) fn plural(&mut self, now_ns: u64, request: &Request) -> Reply {
        let (byte_count, count_max) = self.element(request.command)?;
        refuse_first([
            (request.attribute != 0, Refusal::InvalidAttribute),
            (
                !matches!(request.service, SERVICE_READ_PLURAL | SERVICE_WRITE_PLURAL),
                Refusal::UndefinedCommand,
            ),
        ])?;
        let (count, elements) = request.data.split_first_chunk::<4>().ok_or(Refused::DATA_SIZE)?;
        let count = u32::from_le_bytes(*count) as usize;
        let is_read = request.service == SERVICE_READ_PLURAL;
        let is_odd = byte_count == 1 && count % 2 == 1;
        let size = if is_read { 0 } else { count.saturating_mul(byte_count) };
        refuse_first([
            (count == 0 || count > count_max || is_odd, Refused::VALUE),
            (elements.len() != size, Refused::DATA_SIZE),
        ])?;
        let end = request.instance.checked_add(count as u16).ok_or(Refusal::NoInstance)?;
        if is_read {
            let mut data = (count as u32).to_le_bytes().to_vec();
            for number in request.instance..end {
                self.read_element(now_ns, request.command, number, &mut data)?;
            }
            return Ok(data);
        }
        self.write_elements(now_ns, request, elements, byte_count)?;
        Ok(Vec::new())
    }

    /// Bytes of an element, and how many fit into a datagram.
    fn element(&self, command: u16) -> Result<(usize, usize), Refusal> {
        match command {
            0x300 => Ok((1, 474)),
            0x301 => Ok((2, 237)),
            _ => {
                let (_, byte_count) = self.kind(command)?;
                Ok((byte_count, 474 / byte_count))
            }
        }
    }

    fn read_element(&mut self, now_ns: u64, command: u16, number: u16, data: &mut Vec<u8>) -> Result<(), Refusal> {
        match command {
            0x300 => data.push(self.signal_byte(now_ns, number)?),
            0x301 => data.extend(self.register(now_ns, number).map_err(no_instance)?.to_le_bytes()),
            _ => {
                let (kind, _) = self.kind(command)?;
                let value = self.variable(now_ns, kind, number).map_err(no_instance)?;
                data.extend(value_fields(&value, command).concat());
            }
        }
        Ok(())
    }

    /// All of them, or none where one is refused.
    fn write_elements(
        &mut self,
        now_ns: u64,
        request: &Request,
        elements: &[u8],
        byte_count: usize,
    ) -> Result<(), Refusal> {
        self.advance(now_ns);
        self.check_can_write()?;
        let numbers = request.instance..;
        let last = request.instance + (elements.len() / byte_count) as u16 - 1;
        let pairs = numbers.zip(elements.chunks_exact(byte_count));
        match request.command {
            0x300 => {
                for number in [request.instance, last] {
                    self.signal_byte(now_ns, number)?;
                    let is_network = (NETWORK_IN.first..=NETWORK_IN.last).contains(&number);
                    refuse_first([(!is_network, Refused::USE_FORBIDDEN)])?;
                }
                for (number, element) in pairs {
                    self.set_signal_byte(now_ns, number, element[0])?;
                }
            }
            0x301 => {
                refuse_first([(last >= REGISTER_WRITABLE_COUNT, Refusal::NoInstance)])?;
                for (number, element) in pairs {
                    self.set_register(now_ns, number, u16_at(element, 0))
                        .map_err(no_instance)?;
                }
            }
            command => {
                let (kind, _) = self.kind(command)?;
                let is_beyond = usize::from(last) >= self.variables.count(kind);
                refuse_first([(is_beyond, Refusal::NoInstance)])?;
                let read = |(number, element)| Some((number, value_of(kind, element)?));
                let values: Vec<_> = pairs.map(read).collect::<Option<_>>().ok_or(Refused::DATA_SIZE)?;
                values.iter().try_for_each(|(_, value)| check(value))?;
                for (number, value) in values {
                    self.set_variable(now_ns, number, value).map_err(no_instance)?;
                }
            }
        }
        Ok(())
    }
}
