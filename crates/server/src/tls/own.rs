//! A certificate of our own: signed by itself, so that a person compares its fingerprint once.

use super::der;
use ring::rand::SystemRandom;
use ring::signature::{ECDSA_P256_SHA256_ASN1_SIGNING, EcdsaKeyPair, KeyPair as _};
use scopeservo_library::utc;
use std::net::IpAddr;
use std::time::{Duration, SystemTime};

/// It holds for so long: browsers take none that holds longer than 825 days.
const LASTS: Duration = Duration::from_secs(820 * 86_400);
/// Clocks of others may go after ours by so much.
const BEFORE: Duration = Duration::from_secs(86_400);

/// ecdsa-with-SHA256.
const SIGNED: [u8; 8] = [0x2a, 0x86, 0x48, 0xce, 0x3d, 4, 3, 2];
/// id-ecPublicKey, and its curve, P-256.
const KEY: [u8; 7] = [0x2a, 0x86, 0x48, 0xce, 0x3d, 2, 1];
const CURVE: [u8; 8] = [0x2a, 0x86, 0x48, 0xce, 0x3d, 3, 1, 7];
const COMMON_NAME: [u8; 3] = [0x55, 4, 3];
const KEY_USAGE: [u8; 3] = [0x55, 0x1d, 0x0f];
const OTHER_NAMES: [u8; 3] = [0x55, 0x1d, 0x11];
const CONSTRAINTS: [u8; 3] = [0x55, 0x1d, 0x13];
const USED_FOR: [u8; 3] = [0x55, 0x1d, 0x25];
const SERVER: [u8; 8] = [0x2b, 6, 1, 5, 5, 7, 3, 1];

/// A certificate and its key, both DER.
pub(super) struct Made {
    pub(super) certificate: Vec<u8>,
    /// PKCS #8.
    pub(super) key: Vec<u8>,
}

/// Makes one for these names and addresses.
///
/// # Errors
/// Where the system has no random numbers.
pub(super) fn make(names: &[String], now: SystemTime) -> Result<Made, ring::error::Unspecified> {
    let random = SystemRandom::new();
    let algorithm = &ECDSA_P256_SHA256_ASN1_SIGNING;
    let key = EcdsaKeyPair::generate_pkcs8(algorithm, &random)?;
    let key = key.as_ref().to_vec();
    let pair =
        EcdsaKeyPair::from_pkcs8(algorithm, &key, &random).map_err(|_| ring::error::Unspecified)?;
    let mut number = [0; 16];
    getrandom::fill(&mut number).map_err(|_| ring::error::Unspecified)?;
    // A positive number of that length.
    number[0] = number[0] & 0x7f | 0x40;
    let signed_by = der::of(der::SEQUENCE, &[der::value(der::OID, &SIGNED)]);
    let common = [
        der::value(der::OID, &COMMON_NAME),
        der::value(der::UTF8, b"scopeservo"),
    ];
    let who = der::of(
        der::SEQUENCE,
        &[der::of(der::SET, &[der::of(der::SEQUENCE, &common)])],
    );
    let kind = [der::value(der::OID, &KEY), der::value(der::OID, &CURVE)];
    let public = [
        der::of(der::SEQUENCE, &kind),
        der::bits(pair.public_key().as_ref()),
    ];
    let about = [
        der::of(der::VERSION, &[der::value(der::INTEGER, &[2])]),
        der::value(der::INTEGER, &number),
        signed_by.clone(),
        who.clone(),
        der::of(der::SEQUENCE, &[time(now - BEFORE), time(now + LASTS)]),
        who,
        der::of(der::SEQUENCE, &public),
        der::of(der::EXTENSIONS, &[extensions(names)]),
    ];
    let about = der::of(der::SEQUENCE, &about);
    let signature = pair.sign(&random, &about)?;
    Ok(Made {
        certificate: der::of(
            der::SEQUENCE,
            &[about, signed_by, der::bits(signature.as_ref())],
        ),
        key,
    })
}

fn extensions(names: &[String]) -> Vec<u8> {
    const CRITICAL: [u8; 3] = [1, 1, 0xff];
    let extension = |id: &[u8], critical: &[u8], what: Vec<u8>| {
        let parts = [
            der::value(der::OID, id),
            critical.to_vec(),
            der::value(der::OCTET_STRING, &what),
        ];
        der::of(der::SEQUENCE, &parts)
    };
    let names = names.iter().map(|name| match name.parse() {
        Ok(IpAddr::V4(ip)) => der::value(0x87, &ip.octets()),
        Ok(IpAddr::V6(ip)) => der::value(0x87, &ip.octets()),
        Err(_) => der::value(0x82, name.as_bytes()),
    });
    let all = [
        extension(&CONSTRAINTS, &CRITICAL, der::value(der::SEQUENCE, &[])),
        // Signs, and no more.
        extension(
            &KEY_USAGE,
            &CRITICAL,
            der::value(der::BIT_STRING, &[7, 0x80]),
        ),
        extension(
            &USED_FOR,
            &[],
            der::of(der::SEQUENCE, &[der::value(der::OID, &SERVER)]),
        ),
        extension(
            &OTHER_NAMES,
            &[],
            der::of(der::SEQUENCE, &names.collect::<Vec<_>>()),
        ),
    ];
    der::of(der::SEQUENCE, &all)
}

/// `YYYYMMDDHHMMSSZ`.
pub(super) fn stamp(at: SystemTime) -> String {
    utc(at).replace(['-', ':', 'T'], "")
}

fn time(at: SystemTime) -> Vec<u8> {
    let stamp = stamp(at);
    match stamp.strip_prefix("20") {
        // Until 2049 the year has two digits.
        Some(short) if short < "50" => der::value(der::UTC_TIME, short.as_bytes()),
        _ => der::value(der::GENERAL_TIME, stamp.as_bytes()),
    }
}
