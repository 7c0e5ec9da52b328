# One image for the three services: `python -m controller`, `plant_emulator` or `vision_pc` is its command.
# What is built on can be fixed by its digest: --build-arg BASE=python:3.11-slim-bookworm@sha256:...
ARG BASE=python:3.11-slim-bookworm
FROM ${BASE}

RUN /usr/sbin/useradd --create-home --uid 10001 longreach \
    && python -m venv /opt/longreach \
    && install -d -o longreach -g longreach /var/lib/longreach \
    && install -d -o longreach -g longreach /var/lib/longreach-campaigns /var/lib/longreach-records \
    && install -d -o longreach -g longreach -m 700 /var/lib/longreach-tokens /var/lib/longreach-watch
ENV PATH=/opt/longreach/bin:$PATH \
    OMP_NUM_THREADS=1 \
    OPENBLAS_NUM_THREADS=1 \
    MALLOC_TRIM_THRESHOLD_=268435456 \
    MALLOC_MMAP_THRESHOLD_=268435456 \
    PYTHONUNBUFFERED=1 \
    PYTHONDONTWRITEBYTECODE=1 \
    NUMBA_CACHE_DIR=/var/lib/longreach/numba \
    MPLCONFIGDIR=/var/lib/longreach/matplotlib

# Dependencies first: this layer changes only with the lock file.
WORKDIR /build
COPY requirements.lock ./
RUN pip install --no-cache-dir --quiet --no-deps --require-hashes -r requirements.lock

COPY pyproject.toml README.md LICENSE ./
COPY foundation foundation
COPY protocol protocol
COPY nominal_arm nominal_arm
COPY controller controller
COPY plant_emulator plant_emulator
COPY vision_pc vision_pc
COPY conformance conformance
COPY dissector dissector
COPY testbed testbed
COPY longreach longreach
COPY configs configs
RUN pip install --no-cache-dir --quiet --no-deps --no-build-isolation . && rm -rf /build/*

WORKDIR /srv/longreach
COPY configs configs
USER longreach

# Compiled kernels are part of the image, so that a container starts at once.
RUN python -m testbed.lockstep.warm_up
