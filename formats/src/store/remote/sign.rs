//! Signatures of requests to S3 (AWS Signature Version 4, in the headers).
//!
//! In: credentials, the time, and a request without a body. Out: the headers that prove who asks.
//! See *Authenticating Requests: Using the Authorization Header* in the Amazon S3 API reference.

use std::time::{SystemTime, UNIX_EPOCH};

use hmac::{Hmac, KeyInit, Mac};
use sha2::{Digest, Sha256};

/// Who asks. Has no `Debug`, so that it cannot be printed by accident.
#[derive(Clone)]
pub(super) struct Credentials {
    pub(super) access_key: String,
    pub(super) secret_key: String,
    pub(super) session_token: Option<String>,
}

/// A request to be signed.
pub(super) struct Unsigned<'a> {
    pub(super) host: &'a str,
    /// With its slash, encoded.
    pub(super) path: &'a str,
    /// Encoded, sorted by name.
    pub(super) query: &'a str,
    pub(super) range: Option<&'a str>,
    pub(super) region: &'a str,
}

/// SHA-256 of nothing: no request has a body.
const NO_BODY: &str = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855";

/// The headers of the signed request, beside those that were there.
pub(super) fn headers(
    request: &Unsigned<'_>,
    credentials: &Credentials,
    now: SystemTime,
) -> Vec<(&'static str, String)> {
    let time = timestamp(now);
    let day = &time[..8];
    let mut signed = vec![("host", request.host.to_string())];
    if let Some(range) = request.range {
        signed.push(("range", range.to_string()));
    }
    signed.push(("x-amz-content-sha256", NO_BODY.to_string()));
    signed.push(("x-amz-date", time.clone()));
    if let Some(token) = &credentials.session_token {
        signed.push(("x-amz-security-token", token.clone()));
    }
    let names: Vec<_> = signed.iter().map(|(name, _)| *name).collect();
    let names = names.join(";");
    let lines: String = signed
        .iter()
        .map(|(name, value)| format!("{name}:{}\n", value.trim()))
        .collect();
    let canonical = format!(
        "GET\n{}\n{}\n{lines}\n{names}\n{NO_BODY}",
        request.path, request.query
    );
    let scope = format!("{day}/{}/s3/aws4_request", request.region);
    let digest = hex(&Sha256::digest(canonical.as_bytes()));
    let text = format!("AWS4-HMAC-SHA256\n{time}\n{scope}\n{digest}");
    let first = format!("AWS4{}", credentials.secret_key);
    let key = [day, request.region, "s3", "aws4_request"]
        .iter()
        .fold(first.into_bytes(), |key, part| code(&key, part));
    let signature = hex(&code(&key, &text));
    let mut headers: Vec<_> = signed
        .into_iter()
        .filter(|(name, _)| name.starts_with("x-amz-"))
        .collect();
    headers.push((
        "authorization",
        format!(
            "AWS4-HMAC-SHA256 Credential={}/{scope},SignedHeaders={names},Signature={signature}",
            credentials.access_key
        ),
    ));
    headers
}

/// HMAC-SHA-256.
fn code(key: &[u8], text: &str) -> Vec<u8> {
    // Keys of any length are taken, so there is no error to have.
    let Ok(mut mac) = Hmac::<Sha256>::new_from_slice(key) else {
        return Vec::new();
    };
    mac.update(text.as_bytes());
    mac.finalize().into_bytes().to_vec()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// As `20130524T000000Z`.
fn timestamp(now: SystemTime) -> String {
    let seconds = now.duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
    let (days, second) = (seconds / 86_400, seconds % 86_400);
    let (year, month, day) = date(days);
    format!(
        "{year:04}{month:02}{day:02}T{:02}{:02}{:02}Z",
        second / 3600,
        second / 60 % 60,
        second % 60
    )
}

/// Year, month and day of a number of days since 1970 (Gregorian calendar).
fn date(days: u64) -> (u64, u64, u64) {
    // Years begin in March here, so that the leap day is the last; eras have 400 years.
    let days = days + 719_468;
    let (era, day_of_era) = (days / 146_097, days % 146_097);
    let year_of_era =
        (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 {
        month_from_march + 3
    } else {
        month_from_march - 9
    };
    let year = era * 400 + year_of_era + u64::from(month <= 2);
    (year, month, day)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn the_example_of_the_reference_has_its_signature() {
        let credentials = Credentials {
            access_key: "AKIAIOSFODNN7EXAMPLE".into(),
            secret_key: "wJalrXUtnFEMI/K7MDENG/bPxRfiCYEXAMPLEKEY".into(),
            session_token: None,
        };
        let request = Unsigned {
            host: "examplebucket.s3.amazonaws.com",
            path: "/test.txt",
            query: "",
            range: Some("bytes=0-9"),
            region: "us-east-1",
        };
        let now = UNIX_EPOCH + Duration::from_secs(1_369_353_600);
        let headers = headers(&request, &credentials, now);
        let (_, authorization) = headers.last().unwrap();
        assert!(
            authorization.ends_with(
                "SignedHeaders=host;range;x-amz-content-sha256;x-amz-date,\
                 Signature=f0e8bdb87c964420e857bd35b5d6ed310bd44f0170aba48dd91039c6036bdb41"
            ),
            "{authorization}"
        );
    }

    #[test]
    fn days_have_dates() {
        assert_eq!(date(0), (1970, 1, 1));
        assert_eq!(date(59), (1970, 3, 1));
        assert_eq!(date(11_016), (2000, 2, 29));
        assert_eq!(date(19_782), (2024, 2, 29));
        assert_eq!(date(20_819), (2027, 1, 1));
    }
}
