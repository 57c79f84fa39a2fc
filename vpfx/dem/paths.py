"""Which files GDAL may open, under which name and with which options."""

from __future__ import annotations

import hashlib
import os
import re
import sys
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import rasterio

from vpfx.errors import DemFormatError, InputError, NotFoundError

__all__ = ["Source", "gdal", "gdal_name", "source_of"]

GDAL_OPTIONS = {
    "REPORT_COMPD_CS": "TRUE",  # else DTED and HGT files hide their vertical datum
    "CPL_VSIL_GZIP_WRITE_PROPERTIES": "NO",  # else GDAL leaves a .properties file beside each .gz
    "GDAL_VRT_ENABLE_PYTHON": "NO",  # a VRT is data, it runs no code
    # What a VRT names must be local: remote files have one allowed name that none bears, and HTTP a proxy that is dead.
    "CPL_VSIL_CURL_ALLOWED_FILENAME": "none",
    "GDAL_HTTP_PROXY": "127.0.0.1:9",
    "GDAL_HTTPS_PROXY": "127.0.0.1:9",
    "GDAL_HTTP_MAX_RETRY": "0",
}

# Tells the raster in a .zip from the papers beside it.
RASTER_MEMBER = re.compile(
    r".*\.(adf|asc|bil|bip|bsq|dem|dt[012]|flt|grd|gtx|hgt|img|jp2|nc|ntf|rst|ter|tiff?|vrt)", re.IGNORECASE | re.DOTALL
)
DIGEST_CHUNK = 1 << 20  # bytes read at a time
# /vsi…, http://…, s3:…, zip+https://…; a single letter is a Windows drive.
REMOTE = re.compile(r"/vsi|[A-Za-z][A-Za-z0-9+.-]+:")


@dataclass(frozen=True)
class Source:
    """A file that heights come from.

    Attributes
    ----------
    path : str
        As the user gave it.
    sha256 : str
        Digest of the file's bytes, in hexadecimal. A ``.gz`` or ``.zip`` counts as it is, a VRT without what it names.
    n_byte : int
        Size of the file.
    driver : str
        GDAL's name of the format, such as ``DTED``.

    Examples
    --------
    >>> Source("data/n36.dt2", "", 0, "DTED").name
    'n36.dt2'
    """

    path: str
    sha256: str
    n_byte: int
    driver: str

    @property
    def name(self) -> str:
        """The last part of the path."""
        return Path(self.path).name


@contextmanager
def gdal() -> Iterator[None]:
    """Surround every call to GDAL: with our options, and with nothing printed.

    rasterio raises errors and logs warnings, but prints a traceback where a broken file puts odd bytes into a warning.
    """
    hooks = sys.excepthook, sys.unraisablehook
    sys.excepthook = lambda *_: None
    sys.unraisablehook = lambda _: None
    try:
        with rasterio.Env(**GDAL_OPTIONS):
            yield
    finally:
        sys.excepthook, sys.unraisablehook = hooks


def gdal_name(path: str) -> str:
    """Return the name under which GDAL opens a local file, compressed or not.

    Raises
    ------
    InputError
        The path names something that is not a local file.
    NotFoundError
        There is no such file.
    DemFormatError
        It is a directory or a device, or an archive without exactly one raster.

    Examples
    --------
    >>> gdal_name("https://example.org/n36.dt2")
    Traceback (most recent call last):
    vpfx.errors.InputError: https://example.org/n36.dt2: found a remote or virtual path, expected a local file; ...
    """
    local = Path(path)
    if REMOTE.match(path) and not (local.exists() and not path.startswith("/vsi")):
        raise InputError(f"{path}: found a remote or virtual path, expected a local file; download or unpack it first")
    if not local.exists():
        raise NotFoundError(f"{path}: there is no such file")
    if not local.is_file():
        raise DemFormatError(path, "", "found a directory or a device, expected a raster file")
    full = os.path.abspath(path)  # an absolute path cannot be taken for a name like NETCDF:…
    if local.suffix.lower() == ".gz":
        return f"/vsigzip/{full}"
    if local.suffix.lower() == ".zip":
        return f"/vsizip/{{{full}}}/{_raster_member(path)}"
    return full


def source_of(path: str, driver: str) -> Source:
    """Return the `Source` of a file; it is read once, in pieces.

    Raises
    ------
    DemFormatError
        The file cannot be read.
    """
    digest, n_byte = hashlib.sha256(), 0
    try:
        with open(path, "rb") as file:
            while chunk := file.read(DIGEST_CHUNK):
                digest.update(chunk)
                n_byte += len(chunk)
    except OSError as error:
        raise DemFormatError(path, "", f"cannot be read: {error.strerror}") from error
    return Source(path, digest.hexdigest(), n_byte, driver)


def _raster_member(path: str) -> str:
    """Return the name of the one raster in a zip archive."""
    try:
        with zipfile.ZipFile(path) as archive:
            members = [member for member in archive.infolist() if not member.filename.endswith("/")]
    except (zipfile.BadZipFile, NotImplementedError, OSError, ValueError) as error:
        raise DemFormatError(path, "", f"found a broken archive ({error}), expected a zip file") from error
    rasters = [member for member in members if RASTER_MEMBER.fullmatch(member.filename)]
    rasters = members if len(members) == 1 else rasters
    if len(rasters) != 1:
        raise DemFormatError(path, "", f"found {len(rasters)} rasters, expected exactly one; unpack the archive first")
    method = rasters[0].compress_type
    if method not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) or rasters[0].flag_bits & 1:
        # GDAL before 3.11 decodes Deflate64 (method 9) unsafely: CVE-2026-4738.
        message = f"found compression method {method} or a password, expected a plainly deflated member"
        raise DemFormatError(path, rasters[0].filename, f"{message}; unpack the archive first")
    return rasters[0].filename
