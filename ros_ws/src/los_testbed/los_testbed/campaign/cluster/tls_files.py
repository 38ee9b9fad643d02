"""Client certificates of a campaign for a user's scheduler."""

from __future__ import annotations

import ssl
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lftkit.errors import InputError
from lftkit.support.input_files import check_file
from lftkit.support.input_limits import SECRET

SCHEME = "tls://"


@dataclass(frozen=True)
class TlsFiles:
    """PEM files: trusted authority, and certificate of this process.

    Parameters
    ----------
    ca_file : Path
        Certificate of the authority that signed those of scheduler and workers.
    certificate : Path
    key : Path, optional
        Not encrypted; default: in the file of the certificate.

    Raises
    ------
    ValueError
        A file that cannot be read or holds something else; a key that is not the certificate's.
    """

    ca_file: Path
    certificate: Path
    key: Path | None = None

    def __post_init__(self) -> None:
        for option, path in (("ca-file", self.ca_file), ("cert", self.certificate), ("key", self.key)):
            if path is not None:
                _check_readable(f"--tls-{option}", path)
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        try:
            context.load_verify_locations(self.ca_file)
        except ssl.SSLError:
            raise InputError(f"--tls-ca-file must be a certificate as PEM, got {self.ca_file}") from None
        try:
            context.load_cert_chain(self.certificate, self.key, password=_refuse)
        except ssl.SSLError:
            key = self.key or "no key"
            message = (
                f"--tls-cert and --tls-key must be a certificate and its key as PEM, got {self.certificate}, {key}"
            )
            raise InputError(message) from None

    @classmethod
    def of(cls, scheduler: str, ca_file: Path | None, certificate: Path | None, key: Path | None) -> TlsFiles | None:
        """The files of a command's options for an address; None without them.

        Raises
        ------
        ValueError
            Some without the others, or an address that does not speak TLS; what the class refuses.
        """
        options = {"--tls-ca-file": ca_file, "--tls-cert": certificate, "--tls-key": key}
        named = [option for option, path in options.items() if path is not None]
        if not named:
            return None
        if not scheduler.startswith(SCHEME):
            raise InputError(f"--scheduler must be {SCHEME}HOST:PORT with {named[0]}, got {scheduler or 'none'}")
        if ca_file is None or certificate is None:
            missing = "--tls-ca-file" if ca_file is None else "--tls-cert"
            raise InputError(f"{missing} must be given with {named[0]}, got none")
        return cls(ca_file, certificate, key)


def client_security(scheduler: str, files: TlsFiles | None) -> Any:
    """``distributed.Security`` for the client of an address: of files, or else as Dask is configured.

    Raises
    ------
    ValueError
        An address that speaks TLS, and no certificates for it.
    """
    from distributed.security import Security

    if files is None:
        configured = Security()
        if scheduler.startswith(SCHEME) and not (configured.tls_ca_file and configured.tls_client_cert):
            raise InputError(f"--tls-ca-file and --tls-cert must be given with {scheduler}, got none")
        return configured
    return Security(
        require_encryption=True,
        tls_ca_file=str(files.ca_file),
        tls_client_cert=str(files.certificate),
        tls_client_key=str(files.key) if files.key else None,
    )


def _check_readable(option: str, path: Path) -> None:
    try:
        check_file(path, SECRET)
        path.open("rb").close()
    except OSError as error:
        raise InputError(f"{option} must be a file that can be read, got {path}: {error.strerror}") from None


def _refuse() -> str:
    """Replaces OpenSSL's password prompt on the terminal."""
    raise InputError("--tls-key must be a key without a password")
