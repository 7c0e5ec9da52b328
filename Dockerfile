# Two images: `services` runs the three services and the conformance suites, `campaign` has the laboratory and Dask
# too. `python -m controller`, `plant_emulator` or `vision_pc` is the command.
# What is built on can be fixed by its digest: --build-arg BASE=python:3.11-slim-bookworm@sha256:...
ARG BASE=python:3.11-slim-bookworm

FROM ${BASE} AS build
# Plots and Dask, with what they bring: no service imports them. And what only builds.
ARG FOR_CAMPAIGNS="matplotlib contourpy cycler fonttools kiwisolver pillow pyparsing python-dateutil tzdata \
    dask distributed cloudpickle fsspec importlib-metadata lazy-importer locket msgpack partd sortedcontainers tblib \
    toolz tornado zict zipp"
ARG FOR_BUILDS="editables hatchling packaging pathspec pluggy tomlkit trove-classifiers"
ARG INSTALL="install --no-cache-dir --quiet --no-deps"
WORKDIR /build
# Dependencies first: this layer changes only with the lock file. Byte code is compiled at the end, on all cores;
# tests, debugging symbols, a second back end of zstandard and OpenCV's trained faces are never read.
COPY requirements.lock ./
RUN pick='BEGIN {split(names, list); for (i in list) named[list[i]]} \
        /^[a-z]/ {split($1, pin, "=="); wanted = (pin[1] in named) == keep} wanted' \
    && awk -v keep=1 -v names="$FOR_BUILDS" "$pick" requirements.lock > build.lock \
    && awk -v keep=1 -v names="$FOR_CAMPAIGNS packaging" "$pick" requirements.lock > campaign.lock \
    && awk -v keep=0 -v names="$FOR_CAMPAIGNS $FOR_BUILDS" "$pick" requirements.lock > services.lock \
    && python -m venv /opt/tools && /opt/tools/bin/pip $INSTALL --require-hashes -r build.lock \
    && python -m venv --without-pip /opt/longreach \
    && pip --python /opt/longreach/bin/python $INSTALL --no-compile --require-hashes -r services.lock \
    && cd /opt/longreach/lib/python*/site-packages \
    && find . -depth -type d -name tests -exec rm -rf {} + && rm -rf zstandard/_cffi* cv2/data/*.xml \
    && (apt-get update -qq && apt-get install -y -qq --no-install-recommends binutils > /dev/null \
        && find . -name '*.so*' -not -path './*.libs/*' -exec strip --strip-unneeded {} + \
        || echo "no strip: symbols are kept, the image is 50 MB larger")

COPY pyproject.toml README.md LICENSE ./
COPY foundation foundation
COPY protocol protocol
COPY nominal_arm nominal_arm
COPY structured_text structured_text
COPY controller controller
COPY controller_st controller_st
COPY plc plc
COPY docs/protocol docs/protocol
COPY plant_emulator plant_emulator
COPY vision_pc vision_pc
COPY conformance conformance
COPY dissector dissector
COPY testbed testbed
COPY longreach longreach
COPY longreach_ros2 longreach_ros2
COPY configs configs
COPY laboratory laboratory
RUN /opt/tools/bin/pip wheel --no-cache-dir --quiet --no-deps --no-build-isolation -w wheels . ./laboratory \
    && pip --python /opt/longreach/bin/python $INSTALL --no-compile wheels/longreach-[0-9]*.whl \
    && (python -m compileall -q -j 0 /opt/longreach/lib > /dev/null || true)

FROM ${BASE} AS services
RUN /usr/sbin/useradd --create-home --uid 10001 longreach \
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
COPY --from=build /opt/longreach /opt/longreach
WORKDIR /srv/longreach
COPY configs configs
USER longreach
# Compiled kernels are part of the image, so that a container starts at once.
RUN python -m testbed.lockstep.warm_up

FROM services AS campaign
USER root
COPY --from=build /build/campaign.lock /build/wheels /opt/added/
RUN pip --python /opt/longreach/bin/python install --no-cache-dir --quiet --no-deps --require-hashes -r /opt/added/campaign.lock \
    && pip --python /opt/longreach/bin/python install --no-cache-dir --quiet --no-deps /opt/added/longreach_laboratory-*.whl \
    && rm -rf /opt/added
USER longreach
