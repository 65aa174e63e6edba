/* Reads samples (CSV, see README.md) and writes what @NAME@ says of each of them.

       @NAME@_main [samples.csv] > said.csv

   Without a file it reads standard input. A line that makes no sense ends it: a message, exit code 1. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "@NAME@.h"
#include "@NAME@_numbers.h"

typedef @REAL@ real;
typedef @INPUTS@ inputs;
typedef @STATE@ state;
typedef @OUTPUT@ output;

enum kind { @KINDS@ };
static const char *const kinds[] = {@WORDS@};

struct column {
    const char *name;
    size_t offset; /* in the struct that it is a part of */
    enum kind kind;
};

static const struct column given[] = {
@GIVEN@
};
static const struct column said[] = {
@SAID@
};

enum { GIVEN = sizeof given / sizeof given[0], SAID = sizeof said / sizeof said[0] };
enum { COLUMNS = 1 + GIVEN }; /* the first one is dt */

static struct {
    FILE *file;
    const char *name;
    long line; /* number of the line that was read last */
    char text[32 * COLUMNS + 256];
    const char *fields[COLUMNS];
} source;

static const char *name_of(size_t column) { return column ? given[column - 1].name : "dt"; }

/* Say where the samples make no sense, and that `expected` stood there if they did; return false. */
static bool refuse(const char *where, const char *expected, const char *found)
{
    fprintf(stderr, "%s:%ld: %s: expected %s, not '%s'\n", source.name, source.line, where, expected, found);
    return false;
}

/* Read the next line that is not empty, and cut it into fields. `*end`: there is none. */
static bool read_fields(bool *end)
{
    size_t length, count = 0;
    do {
        source.line++;
        *end = fgets(source.text, (int)sizeof source.text, source.file) == NULL;
        if (*end) return ferror(source.file) ? refuse("line", "a line", "an error of the file") : true;
        length = strlen(source.text);
        if (length + 1 == sizeof source.text && source.text[length - 1] != '\n')
            return refuse("line", "fewer characters", "a longer line");
        source.text[strcspn(source.text, "\r\n")] = '\0';
    } while (source.text[0] == '\0');
    for (char *at = source.text; at != NULL; count++) {
        char *comma = strchr(at, ',');
        if (comma != NULL) *comma++ = '\0';
        if (count < COLUMNS) source.fields[count] = at;
        at = comma;
    }
    if (count == COLUMNS) return true;
    fprintf(stderr, "%s:%ld: expected %d columns, found %lu\n", source.name, source.line, (int)COLUMNS,
            (unsigned long)count);
    return false;
}

static bool read_names(void)
{
    bool end;
    if (!read_fields(&end)) return false;
    if (end) return refuse("line", "the names of the columns", "the end of the file");
    for (size_t k = 0; k < COLUMNS; k++) {
        if (strcmp(source.fields[k], name_of(k)) != 0) return refuse("name", name_of(k), source.fields[k]);
    }
    return true;
}

static bool read_number(size_t column, double *number)
{
    char *end;
    *number = strtod(source.fields[column], &end);
    while (*end == ' ') end++;
    if (end != source.fields[column] && *end == '\0') return true;
    return refuse(name_of(column), "a number", source.fields[column]);
}

/* Put a number where its column says; false if it is none of its kind. */
static bool put(const struct column *column, double number, inputs *in)
{
    unsigned char *const at = (unsigned char *)in + column->offset;
    switch (column->kind) {
@PUT@
    }
    return false;
}

/* Read a sample. `*end`: there is none any more. */
static bool read_sample(real *dt, inputs *in, bool *end)
{
    double number;
    if (!read_fields(end)) return false;
    if (*end) return true;
    if (!read_number(0, &number)) return false;
    if (!(number >= 0)) return refuse("dt", "0 (begin) or more", source.fields[0]);
    *dt = (real)number;
    for (size_t k = 0; k < GIVEN; k++) {
        if (!read_number(k + 1, &number)) return false;
        if (!put(&given[k], number, in)) return refuse(given[k].name, kinds[given[k].kind], source.fields[k + 1]);
    }
    return true;
}

static void show(const struct column *column, const output *out)
{
    const unsigned char *const at = (const unsigned char *)out + column->offset;
    switch (column->kind) {
@SHOW@
    }
}

static bool run(void)
{
    static state states[2]; /* before and after a step, in turn */
    static inputs in;
    static output out;
    real dt;
    bool end;
    if (!read_names() || !read_sample(&dt, &in, &end)) return false;
    if (end) return refuse("line", "a sample", "the end of the file");
    printf("sample");
    for (size_t k = 0; k < SAID; k++) printf(",%s", said[k].name);
    printf("\n");
    for (long sample = 0; !end; sample++) {
        state *const before = &states[sample % 2], *const after = &states[(sample + 1) % 2];
        if (sample == 0) dt = 0;
        if (!(dt > 0)) @NAME@_init(&@NAME@_default, &in, before);
        @NAME@_step(&@NAME@_default, before, &in, &dt, after, &out);
        printf("%ld", sample);
        for (size_t k = 0; k < SAID; k++) show(&said[k], &out);
        printf("\n");
        if (!read_sample(&dt, &in, &end)) return false;
    }
    return true;
}

int main(int count, char **arguments)
{
    source.name = count > 1 ? arguments[1] : "standard input";
    source.file = count > 1 ? fopen(arguments[1], "r") : stdin;
    if (source.file == NULL) {
        perror(source.name);
        return EXIT_FAILURE;
    }
    const bool good = run();
    if (fflush(stdout) != 0 || ferror(stdout)) {
        perror("standard output");
        return EXIT_FAILURE;
    }
    return good ? EXIT_SUCCESS : EXIT_FAILURE;
}
