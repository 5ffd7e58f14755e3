//! Nothing: the tests of this package set bladescan against programs by other hands.
