/* The numbers of @NAME@ for one vehicle: another vehicle, or other parameters, need others. */
#ifndef @UPPER@_NUMBERS_H
#define @UPPER@_NUMBERS_H

#include "@NAME@.h"

#ifdef __cplusplus
extern "C" {
#endif

extern const @NUMBERS@ @NAME@_default;

#ifdef __cplusplus
}
#endif

#endif /* @UPPER@_NUMBERS_H */
