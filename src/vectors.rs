//! The hex vectors of the protocol pages, for tests.

/// A vector of `docs/protocols/hses.md`.
pub(crate) fn hses(name: &str) -> Vec<u8> {
    find(include_str!("../docs/protocols/hses.md"), name)
}

/// A vector of `docs/protocols/camera.md`.
pub(crate) fn a3dp(name: &str) -> Vec<u8> {
    find(include_str!("../docs/protocols/camera.md"), name)
}

/// A vector of `docs/protocols/host_control.md`.
pub(crate) fn host(name: &str) -> Vec<u8> {
    find(include_str!("../docs/protocols/host_control.md"), name)
}

/// A vector of `docs/protocols/bsc_like.md`.
pub(crate) fn bsc(name: &str) -> Vec<u8> {
    find(include_str!("../docs/protocols/bsc_like.md"), name)
}

fn find(page: &str, name: &str) -> Vec<u8> {
    let fence = format!("```hex {name}\n");
    let start = page
        .find(&fence)
        .unwrap_or_else(|| panic!("no vector {name} on the page"));
    let block = &page[start + fence.len()..];
    let digits: Vec<u8> = block[..block.find("```").unwrap()]
        .bytes()
        .filter(u8::is_ascii_hexdigit)
        .collect();
    digits
        .chunks(2)
        .map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap())
        .collect()
}
