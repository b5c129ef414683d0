# The follower for a companion computer, aarch64 or amd64; docs/tutorials/boards.md says how to run it.
#
#   docker build -t follower .
#   docker buildx build --platform linux/arm64 -t follower --load .

FROM python:3.11.13-slim-bookworm AS build
WORKDIR /source
COPY . .
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheel .
RUN python -m venv /opt/follower \
    && /opt/follower/bin/pip install --no-cache-dir -c constraints.txt /wheel/*.whl

FROM python:3.11.13-slim-bookworm
RUN useradd --system --create-home --home-dir /var/lib/follower --groups dialout,video follower
COPY --from=build /opt/follower /opt/follower
ENV PATH=/opt/follower/bin:$PATH \
    OMP_NUM_THREADS=1 \
    FOLLOWER_MODELS=/var/lib/follower/models
USER follower
WORKDIR /var/lib/follower
VOLUME /var/lib/follower
# To stop is to hold: SIGTERM brakes the vehicle first.
STOPSIGNAL SIGTERM
ENTRYPOINT ["/opt/follower/bin/follower"]
CMD ["--help"]
