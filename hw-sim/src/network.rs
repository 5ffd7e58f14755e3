//! What a network does to what it carries: one way between client and robot as a value, pieces in, deliveries out.
//!
//! Every piece has draws of its own from the seed, so that what befalls one never depends on the others.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::draws::{Purpose, generator, uniform};
use crate::fault::Fault;

/// How often what goes wrong on the way; a share counts pieces: a datagram, a segment of a stream, a burst on the serial line.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NetworkFaults {
    /// Share of pieces that get lost. A stream sends them again; the serial line loses one byte of the piece.
    pub loss_fraction: f64,
    /// Share of datagrams that come twice.
    pub duplicate_fraction: f64,
    /// Share of datagrams that come [`REORDER_NS`] later, so that others overtake them; a stream is held up that long.
    pub reorder_fraction: f64,
    /// Share of pieces with one wrong bit. A stream notices and sends them again.
    pub flip_fraction: f64,
    /// Time every piece takes, ns.
    pub delay_ns: u64,
}

impl NetworkFaults {
    /// Those among the faults of a cell.
    pub fn among(faults: &[Fault]) -> Self {
        let mut network = Self::default();
        for fault in faults {
            match *fault {
                Fault::NetLoss { fraction } => network.loss_fraction = fraction,
                Fault::NetDuplicate { fraction } => network.duplicate_fraction = fraction,
                Fault::NetReorder { fraction } => network.reorder_fraction = fraction,
                Fault::NetFlip { fraction } => network.flip_fraction = fraction,
                Fault::NetDelay { delay_ms } => network.delay_ns = (delay_ms * 1e6).round() as u64,
                _ => (),
            }
        }
        network
    }
}

/// How pieces are carried.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Carriage {
    /// Whole, in any order.
    Datagrams,
    /// As the bytes of a stream: all of them, in order.
    Stream,
    /// As characters one after the other, each of which takes this long, ns. A piece comes when its last one has.
    Characters(u64),
}

/// One way of one path.
#[derive(Clone, Debug)]
pub struct Network {
    faults: NetworkFaults,
    carriage: Carriage,
    seed: u64,
    which: u64,
    piece_count: u64,
    /// Nothing leaves before.
    stalled_until_ns: u64,
    /// When the piece before this one arrived, where the order is kept.
    last_ns: u64,
}

/// A piece and when it arrives.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Delivery {
    /// Time of the arrival, ns.
    pub at_ns: u64,
    /// What arrives.
    pub bytes: Vec<u8>,
}

impl Network {
    /// Way on which nothing has passed yet; `which` tells it from the other ways of the same seed.
    pub fn new(faults: NetworkFaults, carriage: Carriage, seed: u64, which: u64) -> Self {
        Self {
            faults,
            carriage,
            seed,
            which,
            piece_count: 0,
            stalled_until_ns: 0,
            last_ns: 0,
        }
    }

    /// Holds everything that is pushed before this time until then.
    pub fn stall(&mut self, until_ns: u64) {
        self.stalled_until_ns = self.stalled_until_ns.max(until_ns);
    }

    /// Sends a piece and says what arrives when: nothing, it, or it twice.
    pub fn push(&mut self, now_ns: u64, mut bytes: Vec<u8>) -> Vec<Delivery> {
        let fate = Fate::draw(&self.faults, self.seed, self.which, self.piece_count);
        self.piece_count += 1;
        let Fate {
            is_lost,
            is_doubled,
            is_late,
            flip,
            byte,
        } = fate;
        let late_ns = if is_late { REORDER_NS } else { 0 };
        let mut at_ns = now_ns.max(self.stalled_until_ns) + self.faults.delay_ns;
        match self.carriage {
            Carriage::Datagrams => {
                if is_lost {
                    return Vec::new();
                }
                flip_bit(&mut bytes, flip);
                at_ns += late_ns;
            }
            Carriage::Stream => {
                let again_ns = if is_lost || flip.is_some() {
                    RETRANSMISSION_NS
                } else {
                    0
                };
                at_ns = (at_ns + again_ns + late_ns).max(self.last_ns);
                self.last_ns = at_ns;
            }
            Carriage::Characters(character_ns) => {
                at_ns = at_ns.max(self.last_ns) + character_ns * bytes.len() as u64;
                self.last_ns = at_ns;
                flip_bit(&mut bytes, flip);
                if is_lost && !bytes.is_empty() {
                    bytes.remove(byte % bytes.len());
                }
            }
        }
        let copy_count = 1 + usize::from(is_doubled && self.carriage == Carriage::Datagrams);
        vec![Delivery { at_ns, bytes }; copy_count]
    }
}

/// What befalls one piece.
struct Fate {
    is_lost: bool,
    is_doubled: bool,
    is_late: bool,
    /// A bit to flip, as a count of bits that wraps around.
    flip: Option<usize>,
    /// A byte to lose, as a count of bytes that wraps around.
    byte: usize,
}

impl Fate {
    /// Every piece takes the same draws, whatever the shares are.
    fn draw(faults: &NetworkFaults, seed: u64, which: u64, piece: u64) -> Self {
        let mut rng = generator(seed, Purpose::Network, which, piece);
        let happens = |rng: &mut ChaCha8Rng, fraction| uniform(rng) < fraction;
        let is_lost = happens(&mut rng, faults.loss_fraction);
        let is_doubled = happens(&mut rng, faults.duplicate_fraction);
        let is_late = happens(&mut rng, faults.reorder_fraction);
        let is_flipped = happens(&mut rng, faults.flip_fraction);
        let bit = rng.random::<u32>() as usize;
        let byte = rng.random::<u32>() as usize;
        Self {
            is_lost,
            is_doubled,
            is_late,
            flip: is_flipped.then_some(bit),
            byte,
        }
    }
}

fn flip_bit(bytes: &mut [u8], bit: Option<usize>) {
    let byte_count = bytes.len();
    if let Some(bit) = bit
        && byte_count > 0
    {
        bytes[bit / 8 % byte_count] ^= 1 << (bit % 8);
    }
}

/// A datagram that others overtake comes this much later.
pub const REORDER_NS: u64 = 20_000_000;
/// A stream's segment that got lost comes again after this.
pub const RETRANSMISSION_NS: u64 = 200_000_000;

#[cfg(test)]
mod tests {
    use super::*;

    const PIECE_COUNT: u64 = 10_000;

    fn network(faults: &[&str], carriage: Carriage) -> Network {
        let faults: Vec<Fault> = faults.iter().map(|fault| fault.parse().unwrap()).collect();
        Network::new(NetworkFaults::among(&faults), carriage, 1, 0)
    }

    /// Arrivals of pieces that are sent 1 ms apart, each of the eight bytes of its count.
    fn deliveries(faults: &[&str], carriage: Carriage) -> Vec<Delivery> {
        let mut network = network(faults, carriage);
        (0..PIECE_COUNT)
            .flat_map(|piece| network.push(piece * 1_000_000, piece.to_le_bytes().to_vec()))
            .collect()
    }

    fn share(count: usize) -> f64 {
        count as f64 / PIECE_COUNT as f64
    }

    fn wrong_bit_count(deliveries: &[Delivery]) -> u32 {
        let bits = |delivery: &Delivery| u64::from_le_bytes(delivery.bytes[..].try_into().unwrap());
        (0..)
            .zip(deliveries)
            .map(|(piece, delivery)| (bits(delivery) ^ piece).count_ones())
            .sum()
    }

    #[test]
    fn without_faults_everything_arrives_at_once() {
        for carriage in [Carriage::Datagrams, Carriage::Stream, Carriage::Characters(0)] {
            let arrived = deliveries(&[], carriage);
            assert_eq!(arrived.len() as u64, PIECE_COUNT);
            assert!(
                (0..)
                    .zip(&arrived)
                    .all(|(piece, delivery)| delivery.at_ns == piece * 1_000_000)
            );
            assert_eq!(wrong_bit_count(&arrived), 0);
        }
    }

    #[test]
    fn each_share_of_datagrams_meets_its_fault() {
        let lost = PIECE_COUNT as usize - deliveries(&["net-loss=0.05"], Carriage::Datagrams).len();
        let doubled = deliveries(&["net-duplicate=0.05"], Carriage::Datagrams).len() - PIECE_COUNT as usize;
        let flipped = wrong_bit_count(&deliveries(&["net-flip=0.05"], Carriage::Datagrams)) as usize;
        let late = deliveries(&["net-reorder=0.05"], Carriage::Datagrams);
        let late = (0..)
            .zip(&late)
            .filter(|(piece, delivery)| delivery.at_ns == piece * 1_000_000 + REORDER_NS)
            .count();
        for count in [lost, doubled, flipped, late] {
            assert!((share(count) - 0.05).abs() < 0.01, "{count}");
        }
        let delayed = deliveries(&["net-delay=2.5"], Carriage::Datagrams);
        assert!(
            (0..)
                .zip(&delayed)
                .all(|(piece, delivery)| delivery.at_ns == piece * 1_000_000 + 2_500_000)
        );
    }

    #[test]
    fn a_stream_keeps_every_byte_and_their_order() {
        let faults = [
            "net-loss=0.1",
            "net-duplicate=0.1",
            "net-reorder=0.1",
            "net-flip=0.1",
            "net-delay=1",
        ];
        let arrived = deliveries(&faults, Carriage::Stream);
        assert_eq!((arrived.len() as u64, wrong_bit_count(&arrived)), (PIECE_COUNT, 0));
        assert!(arrived.is_sorted_by_key(|delivery| delivery.at_ns));
        assert!(arrived[10].at_ns > 11_000_000, "some piece before it had to come again");
    }

    #[test]
    fn characters_take_their_time_and_lose_single_bytes() {
        let mut line = network(&[], Carriage::Characters(1_000));
        assert_eq!(line.push(5, vec![1; 10])[0].at_ns, 10_005);
        assert_eq!(line.push(6, vec![1; 10])[0].at_ns, 20_005, "behind the piece before");
        let arrived = deliveries(&["net-loss=0.05"], Carriage::Characters(0));
        let short = arrived.iter().filter(|delivery| delivery.bytes.len() == 7).count();
        assert_eq!(arrived.len() as u64, PIECE_COUNT);
        assert!((share(short) - 0.05).abs() < 0.01, "{short}");
    }

    #[test]
    fn a_stalled_way_delivers_everything_at_its_end() {
        let mut network = network(&[], Carriage::Datagrams);
        network.stall(100);
        assert_eq!(network.push(10, vec![1])[0].at_ns, 100);
        assert_eq!(network.push(110, vec![1])[0].at_ns, 110);
    }

    #[test]
    fn the_fate_of_a_piece_depends_on_seed_way_and_count_alone() {
        let fates = |seed, which| {
            let faults = NetworkFaults {
                loss_fraction: 0.5,
                ..NetworkFaults::default()
            };
            let mut network = Network::new(faults, Carriage::Datagrams, seed, which);
            (0..64).map(|_| network.push(0, vec![1]).len()).collect::<Vec<_>>()
        };
        assert_eq!(fates(1, 0), fates(1, 0));
        assert_ne!(fates(1, 0), fates(2, 0));
        assert_ne!(fates(1, 0), fates(1, 1));
    }
}
