//! Registration by the methods that the paper compares itself with, and by bladescan's own, on cases with known truth.
//!
//! Each method is a module of its own that cites its source and says where it simplifies; parameters are its authors'
//! defaults, or say why not. All start from the identity, use rayon's threads, and give the same bits at any number of them.

mod affinity;
mod bcpd;
mod closest;
mod compare;
mod cpd;
mod em_icp;
mod expectation;
mod exponential;
mod hmm;
mod icp;
mod lm_icp;
pub(crate) mod product;
#[cfg(test)]
mod testing;
pub(crate) mod tricp;

use bladescan::geometry::PointCloud;
use clap::ValueEnum;
use nalgebra::Isometry3;

pub(crate) use self::compare::{MethodsArguments, run};

/// A way to register two clouds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Method {
    /// bladescan's registration as a user calls it.
    Bladescan,
    /// MPE alone, on samples of 500 points.
    Mpe,
    /// MPE, then trimmed ICP over all points: the paper's method.
    MpeTricp,
    /// Iterative closest point.
    Icp,
    /// Trimmed ICP, the overlap searched.
    Tricp,
    /// Levenberg-Marquardt over robust distances.
    LmIcp,
    /// Annealed multiply linked ICP.
    EmIcp,
    /// Rigid coherent point drift.
    Cpd,
    /// Rigid Bayesian coherent point drift.
    Bcpd,
    /// Hybrid mixture of places and normals.
    Hmm,
}

impl Method {
    /// Its name on the command line and in tables.
    pub(crate) fn name(self) -> String {
        self.to_possible_value()
            .map_or_else(String::new, |value| value.get_name().to_owned())
    }

    /// The motion target_from_source that it finds from the identity.
    pub(crate) fn estimate(self, source: &PointCloud, target: &PointCloud) -> Isometry3<f64> {
        let start = Isometry3::identity();
        match self {
            Self::Bladescan => product::register(source, target),
            Self::Mpe => product::mpe(source, target, &start),
            Self::MpeTricp => {
                let near = product::mpe(source, target, &start);
                tricp::register(source, target, &near, &tricp::TrimmedSettings::default())
            }
            Self::Icp => icp::register(source, target, &start, &icp::IcpSettings::default()),
            Self::Tricp => tricp::register(source, target, &start, &tricp::TrimmedSettings::default()),
            Self::LmIcp => lm_icp::register(source, target, &start, &lm_icp::LmSettings::default()),
            Self::EmIcp => em_icp::register(source, target, &start, &em_icp::EmIcpSettings::default()),
            Self::Cpd => cpd::register(source, target, &start, &cpd::CpdSettings::default()),
            Self::Bcpd => bcpd::register(source, target, &start, &bcpd::BcpdSettings::default()),
            Self::Hmm => hmm::register(source, target, &start, &hmm::HmmSettings::default()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::ThreadPoolBuilder;

    #[test]
    fn every_method_gives_the_same_bits_at_any_number_of_threads() {
        let pair = testing::noisy(700, 20.0, 0.03);
        let pools = [1, 2, 5].map(|count| ThreadPoolBuilder::new().num_threads(count).build().unwrap());
        for method in Method::value_variants() {
            let found = pools
                .each_ref()
                .map(|pool| pool.install(|| method.estimate(&pair.source, &pair.target)).to_matrix());
            let bits = found.map(|matrix| matrix.map(f64::to_bits));
            assert!(bits[0] == bits[1] && bits[1] == bits[2], "{}", method.name());
        }
    }
}
